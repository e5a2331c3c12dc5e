// Table of surfaces. All text is set as text, never as markup.
export function render({ model, el }) {
  const root = document.createElement("div");
  const make = (tag, name, parent, text = "") => {
    const node = document.createElement(tag);
    if (name) node.className = name;
    if (text) node.textContent = text;
    parent.append(node);
    return node;
  };
  const glasses = make("datalist", "", root);
  glasses.id = "table-glasses";
  const scroll = make("div", "scroll", root);
  scroll.tabIndex = 0;
  scroll.setAttribute("role", "region");
  scroll.ariaLabel = "Table of surfaces";
  const refusal = make("div", "refusal", root);
  refusal.setAttribute("role", "alert");
  const active = () => root.getRootNode().activeElement;
  let shape = "", parts = [];

  // Arrow keys up and down go to the same column of the next surface, as in other design programs.
  const moved = (event, row, column) => {
    const by = { ArrowUp: -1, ArrowDown: 1 }[event.key];
    if (!by) return;
    event.preventDefault();
    for (let k = row + by; k >= 0 && k < model.rows.length; k += by) {
      const found = parts.find((part) => part.row === k && part.column === column && part.box);
      if (found) { found.box.focus(); found.box.select(); return; }
    }
  };
  const cellOf = (cell, row, column, parent) => {
    const part = { row, column, cell, box: null, flag: null, ends: [] };
    if (!cell.key) { parent.className = "text"; part.plain = parent; return part; }
    const line = make("div", "value", parent);
    part.box = make("input", cell.kind === "glass" ? "glass" : "", line);
    part.box.type = "text";
    part.box.spellcheck = false;
    part.box.ariaLabel = `table: ${cell.label}`;
    if (cell.kind === "glass") {
      part.box.setAttribute("list", glasses.id);
      part.box.oninput = () => model.send_msg({ search: part.box.value });
    }
    part.box.onchange = () =>
      model.send_msg({ key: part.cell.key, kind: part.cell.kind, text: part.box.value });
    part.box.onkeydown = (event) => {
      if (event.key === "Escape") { part.box.value = part.cell.text; part.box.blur(); }
      else if (cell.kind !== "glass") moved(event, row, column);
    };
    if (!cell.variable) return part;
    part.flag = make("button", "", line, "V");
    part.flag.title = part.flag.ariaLabel = `Vary ${cell.label} in searches`;
    part.flag.onclick = () => model.send_msg({ varied: cell.variable, is_varied: !part.cell.varied });
    const range = make("div", cell.single ? "range single" : "range", parent);
    range.append(cell.single ? "|R| ≥" : "");
    cell.range.forEach((_, k) => {
      if (k) range.append("…");
      const end = make("input", "", range);
      end.type = "text";
      end.ariaLabel = `${cell.label}, ${cell.single ? "smallest" : k ? "largest" : "smallest"} in searches`;
      end.onchange = () =>
        model.send_msg({ bounds: cell.variable, texts: part.ends.map((one) => one.value) });
      part.ends.push(end);
    });
    return part;
  };
  const build = () => {
    scroll.replaceChildren();
    parts = [];
    const table = make("table", "", scroll);
    const head = make("tr", "", make("thead", "", table));
    for (const name of ["", "type", ...model.columns]) make(name ? "th" : "td", "", head, name).scope = "col";
    const body = make("tbody", "", table);
    model.rows.forEach((row, index) => {
      const line = make("tr", "", body);
      const name = make("th", "", line, row.name);
      name.scope = "row";
      if (row.note) make("small", "", name, row.note);
      if (row.actions.length) {
        const actions = make("div", "actions", name);
        for (const [action, label, hint] of row.actions) {
          const button = make("button", "", actions, label);
          button.title = button.ariaLabel = `${hint} (table)`;
          button.onclick = () => model.send_msg({ action, group: row.name });
        }
      }
      const type = make("td", "", line);
      if (row.shape) {
        const choice = make("select", "", type);
        choice.ariaLabel = `${row.name} type`;
        for (const one of model.shapes) make("option", "", choice, one).value = one;
        choice.onchange = () => model.send_msg({ surface: row.surface, shape: choice.value });
        parts.push({ row: index, column: -1, choice });
      }
      row.cells.forEach((cell, column) => {
        const place = make("td", "", line);
        if (cell) parts.push(cellOf(cell, index, column, place));
      });
    });
  };
  const update = () => {
    const now = JSON.stringify([model.columns, model.rows.map((row) => [row.name, row.note, row.actions, row.shape !== "",
      row.cells.map((cell) => cell && [cell.key, cell.kind, cell.variable, cell.single])])]);
    if (now !== shape) { shape = now; build(); }
    for (const part of parts) {
      const row = model.rows[part.row];
      if (part.choice) { part.choice.value = row.shape; continue; }
      const cell = part.cell = row.cells[part.column];
      if (part.plain) { part.plain.textContent = cell.text; continue; }
      if (active() !== part.box && !(cell.key in model.refused)) part.box.value = cell.text;
      part.box.setAttribute("aria-invalid", String(cell.key in model.refused));
      if (!part.flag) continue;
      part.flag.setAttribute("aria-pressed", String(cell.varied));
      part.ends.forEach((end, k) => {
        end.disabled = !cell.varied;
        if (active() !== end && !(cell.variable in model.refused)) end.value = cell.range[k];
        end.setAttribute("aria-invalid", String(cell.variable in model.refused));
      });
    }
    const keys = parts.flatMap((part) => (part.cell ? [part.cell.key, part.cell.variable] : []));
    refusal.textContent = Object.entries(model.refused)
      .filter(([key]) => key === "" || keys.includes(key)).map(([, why]) => why).join("\n");
  };
  const offer = () => glasses.replaceChildren(...model.glasses.map((name) => {
    const option = document.createElement("option");
    option.value = name;
    return option;
  }));
  for (const key of ["rows", "columns", "refused"]) model.on(key, update);
  model.on("glasses", offer);
  update();
  return root;
}
