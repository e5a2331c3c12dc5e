// One row for each value: name, slider and text box. All text is set as text, never as markup.
export function render({ model, el }) {
  const rows = new Map();
  let shape = "", gesture = 0, waiting = null, touched = -1e9, later = 0;
  const root = document.createElement("div");
  root.className = "values";
  const glasses = document.createElement("datalist");
  glasses.id = "glasses";
  root.append(glasses);

  const make = (tag, name, parent) => {
    const node = document.createElement(tag);
    if (name) node.className = name;
    parent.append(node);
    return node;
  };
  const session = Math.random().toString(36).slice(2);
  // While a slider is dragged, only the newest value of each frame is sent. Typed values are sent at once.
  const flush = () => { const one = waiting; waiting = null; if (one) model.send_msg(one); };
  const send = (row, text, whole) => {
    touched = performance.now();
    clearTimeout(later);
    later = setTimeout(update, 450);
    if (waiting && waiting.key !== row.key) flush();
    if (!waiting && !whole) requestAnimationFrame(flush);
    waiting = { key: row.key, kind: row.kind, text, gesture: whole ? "" : session + gesture };
    if (whole) flush();
  };
  const digits = (value, step) => {
    const places = Math.max(0, Math.min(12, 1 - Math.floor(Math.log10(step))));
    return String(Number(Number(value).toFixed(places)));
  };
  const stepped = (cell, event) => {
    const sign = { ArrowUp: 1, ArrowRight: 1, ArrowDown: -1, ArrowLeft: -1 }[event.key];
    const inBox = event.target === cell.box;
    if (!sign || !cell.row.step || (inBox && /Left|Right/.test(event.key))) return;
    const now = Number(cell.box.value);
    if (!Number.isFinite(now)) return;
    event.preventDefault();
    if (!event.repeat) gesture += 1;
    const next = digits(now + sign * cell.row.step * (event.shiftKey ? 10 : 1), cell.row.step);
    show(cell, next);
    send(cell.row, next, false);
  };
  const show = (cell, text) => {
    cell.typed = false;
    cell.box.value = text;
    if (cell.slider) {
      cell.slider.value = text;
      const { low, high } = cell.row;
      cell.slider.style.setProperty("--at", `${(100 * (Number(text) - low)) / (high - low)}%`);
    }
  };

  const build = () => {
    root.replaceChildren(glasses);
    rows.clear();
    let group = "", body = null;
    for (const row of model.rows) {
      if (row.group !== group) {
        group = row.group;
        body = make("section", "group", root);
        body.setAttribute("aria-label", group);
        const head = make("header", "", body);
        make("span", "name", head).textContent = group;
        if (row.note) make("span", "note", head).textContent = row.note;
        for (const [action, label, hint] of row.actions || []) {
          const button = make("button", "", head);
          button.textContent = label;
          button.title = button.ariaLabel = `${hint}`;
          button.onclick = () => model.send_msg({ action, group: row.group });
        }
      }
      const line = make("div", "row", body);
      const label = make("label", "", line);
      label.textContent = row.label;
      const name = `${row.group} ${row.label}${row.unit ? ", " + row.unit : ""}`;
      const cell = { row, line, slider: null };
      const middle = make("div", "middle", line);
      if (row.number !== null) {
        cell.slider = make("input", "", middle);
        cell.slider.type = "range";
        cell.slider.ariaLabel = `${name}, slider`;
        cell.slider.onpointerdown = () => { gesture += 1; };
        cell.slider.oninput = () => {
          const text = digits(cell.slider.value, cell.row.step);
          show(cell, text);
          send(cell.row, text, false);
        };
        cell.slider.onkeydown = (event) => stepped(cell, event);
      }
      cell.box = make("input", row.number === null && row.kind !== "whole" ? "wide" : "", line);
      cell.box.type = "text";
      cell.box.spellcheck = false;
      cell.box.ariaLabel = name;
      if (row.kind === "glass") {
        cell.box.setAttribute("list", "glasses");
        cell.box.oninput = () => model.send_msg({ search: cell.box.value });
      }
      cell.box.addEventListener("input", () => { cell.typed = true; });
      cell.box.onchange = () => { gesture += 1; cell.typed = false; send(cell.row, cell.box.value, true); };
      cell.box.onkeydown = (event) => {
        if (event.key === "Escape") { show(cell, cell.row.text); cell.box.blur(); }
        else stepped(cell, event);
      };
      make("span", "unit", line).textContent = row.unit;
      cell.refusal = make("div", "refusal", body);
      cell.refusal.setAttribute("role", "alert");
      rows.set(row.key, cell);
    }
  };

  const update = () => {
    const now = JSON.stringify(model.rows.map((r) => [r.key, r.group, r.number === null, r.note, r.actions]));
    if (now !== shape) { shape = now; build(); }
    const active = root.getRootNode().activeElement;
    for (const row of model.rows) {
      const cell = rows.get(row.key);
      cell.row = row;
      if (cell.slider) { cell.slider.min = row.low; cell.slider.max = row.high; cell.slider.step = row.step; }
      // A value that is being changed on the page is newer than the server's value.
      const focused = active === cell.slider || active === cell.box;
      const busy = focused && (cell.typed || performance.now() - touched < 400);
      if (!busy && !(row.key in model.refused)) show(cell, row.text);
    }
    for (const [key, cell] of rows) {
      const text = model.refused[key] || "";
      cell.refusal.textContent = text;
      cell.line.classList.toggle("bad", text !== "");
    }
  };
  const offer = () => glasses.replaceChildren(...model.glasses.map((name) => {
    const option = document.createElement("option");
    option.value = name;
    return option;
  }));
  model.on("rows", update);
  model.on("refused", update);
  model.on("glasses", offer);
  update();
  return root;
}
