// Top bar: title, undo, redo, save, theme and their keys. It also checks that the server is still running.
export function render({ model, el }) {
  const root = document.createElement("div");
  root.className = "bar";
  const make = (tag, name, parent = root) => {
    const node = document.createElement(tag);
    node.className = name;
    parent.append(node);
    return node;
  };
  make("span", "mark").textContent = "transferlens";
  const title = make("span", "title"), file = make("span", "file");
  const waiting = make("span", "file");
  waiting.textContent = "computing…";
  waiting.hidden = true;
  waiting.setAttribute("role", "status");
  const message = make("span", "message");
  message.setAttribute("role", "status");
  const button = (label, hint, act) => {
    const node = make("button", "");
    node.textContent = label;
    node.title = node.ariaLabel = hint;
    node.onclick = act;
    return node;
  };
  const ask = (action) => () => model.send_msg({ action });
  const undo = button("↶ Undo", "Undo (Ctrl+Z)", ask("undo"));
  const redo = button("↷ Redo", "Redo (Ctrl+Shift+Z)", ask("redo"));
  const picker = filePicker(model, root);
  button("Open…", "Open another design", () => picker.open(
    { mode: "open", title: "Open a design", start: model.file, suffixes: [".toml"] },
    (file) => model.send_msg({ action: "open", file })));
  const name = make("input", "name");
  name.ariaLabel = "File to save to";
  name.spellcheck = false;
  const save = button("Save", "Save (Ctrl+S)", () => model.send_msg({ action: "save", file: name.value }));
  button("◐", "Dark or light", () => dress(page.dataset.theme === "dark" ? "light" : "dark"));
  const page = document.documentElement;
  const dress = (theme) => {
    page.dataset.theme = theme;
    try { localStorage.setItem("studio-theme", theme); } catch {}
    model.send_msg({ theme });
  };

  const update = () => {
    title.textContent = model.title || "untitled";
    file.textContent = model.is_saved ? "" : "● unsaved";
    undo.disabled = !model.can_undo;
    redo.disabled = !model.can_redo;
    undo.title = model.can_undo ? `Undo: ${model.undo} (Ctrl+Z)` : "Nothing to undo";
    if (root.getRootNode().activeElement !== name) name.value = model.file;
    message.textContent = model.message;
    message.classList.toggle("bad", model.is_bad);
  };
  const first_design = model.opened;
  model.on("opened", () => { if (model.opened !== first_design) location.reload(); });
  // Figures of an earlier state are dimmed if the new ones take long.
  let dimmed = 0;
  const pending = () => {
    clearTimeout(dimmed);
    if (model.is_analysed) { delete page.dataset.pending; waiting.hidden = true; }
    else dimmed = setTimeout(() => { page.dataset.pending = ""; waiting.hidden = false; }, 600);
  };
  model.on("is_analysed", pending);
  for (const key of ["title", "file", "is_saved", "can_undo", "can_redo", "undo", "message", "is_bad"])
    model.on(key, update);

  document.addEventListener("keydown", (event) => {
    if (!(event.ctrlKey || event.metaKey)) return;
    const key = event.key.toLowerCase();
    const action = key === "z" ? (event.shiftKey ? "redo" : "undo") : key === "y" ? "redo" : key === "s" ? "save" : "";
    if (!action) return;
    event.preventDefault();
    let typed = document.activeElement;
    while (typed?.shadowRoot?.activeElement) typed = typed.shadowRoot.activeElement;
    if (action === "save") typed?.blur();  // applies the typed text before it is saved
    model.send_msg({ action, file: name.value });
  });

  // The page asks the server every second. If a new server answers, the page is reloaded with the stored edits.
  let gone = false, first = null;
  const banner = document.getElementById("gone");
  const look = async () => {
    try {
      const answer = await fetch("alive", { cache: "no-store" });
      if (!answer.ok) throw new Error(String(answer.status));
      const now = await answer.text();
      first ??= now;
      if (now !== first || gone) location.reload();
    } catch {
      gone = first !== null;
      if (banner && gone) { banner.hidden = false; document.getElementById("page").inert = true; }
    }
  };
  // The library gives no name to the pictures of charts.
  const nameCharts = () => {
    for (const one of window.Bokeh?.documents?.[0]?.all_models || []) {
      const view = one.type === "Figure" && one.name ? Bokeh.index.find_one(one) : null;
      view?.el.setAttribute("role", "img");
      view?.el.setAttribute("aria-label", one.name);
      // Charts take no keys.
      if (view?.canvas_view?.events_el) view.canvas_view.events_el.tabIndex = -1;
    }
  };
  if (banner) { look(); setInterval(() => { look(); nameCharts(); }, 1000); }
  if (banner) dress(page.dataset.theme || "light");
  update();
  pending();
  return root;
}
