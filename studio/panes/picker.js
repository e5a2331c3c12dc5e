// Dialog in which a file or folder of this machine is chosen, with the recent ones. Bars and panes use it.
function filePicker(model, root) {
  const make = (tag, name, parent, text = "") => {
    const node = document.createElement(tag);
    if (name) node.className = name;
    if (text) node.textContent = text;
    parent.append(node);
    return node;
  };
  const dialog = make("dialog", "picker", root);
  const heading = make("h2", "", dialog);
  heading.id = "picker-title";
  dialog.setAttribute("aria-labelledby", heading.id);
  const recent = make("div", "recent", dialog);
  const line = make("div", "line", dialog);
  const up = make("button", "", line, "↑ Up");
  up.title = up.ariaLabel = "Parent folder";
  const path = make("input", "", line);
  path.type = "text";
  path.spellcheck = false;
  path.ariaLabel = "Path";
  const problem = make("p", "problem", dialog);
  problem.setAttribute("role", "alert");
  const list = make("ul", "entries", dialog);
  list.ariaLabel = "Folders and files";
  const foot = make("div", "line foot", dialog);
  const cancel = make("button", "", foot, "Cancel");
  const choose = make("button", "main", foot, "Choose");
  let wanted = { mode: "open" }, done = () => {};

  const ask = (folder) => model.send_msg({ list: folder, suffixes: wanted.suffixes || [] });
  const join = (folder, name) => (folder.endsWith("/") ? folder : folder + "/") + name;
  const finish = (chosen) => { dialog.close(); if (chosen) done(chosen); };
  const item = (label, hint, parent, act) => {
    const button = make("button", "", make("li", "", parent), label);
    button.title = hint;
    button.onclick = act;
    return button;
  };
  const show = () => {
    const { folder, parent, entries, error } = model.listing;
    problem.textContent = error || "";
    list.replaceChildren();
    if (!folder) return;
    up.disabled = !parent;
    up.onclick = () => ask(parent);
    const name = wanted.mode === "save" ? path.value.split("/").pop() : "";
    path.value = wanted.mode === "save" ? join(folder, name) : folder;
    for (const [label, isFolder] of entries) {
      const whole = join(folder, label);
      item(isFolder ? `${label}/` : label, whole, list, () => {
        if (isFolder) ask(whole);
        else if (wanted.mode === "save") path.value = whole;
        else finish(whole);
      });
    }
    if (!entries.length) make("li", "none", list, "nothing to choose here");
  };
  const showRecent = () => {
    recent.replaceChildren();
    if (wanted.mode === "save" || !model.recent.length) return;
    make("h3", "", recent, "Recent");
    const own = make("ul", "", recent);
    for (const whole of model.recent) item(whole, whole, own, () => finish(whole));
  };
  cancel.onclick = () => finish("");
  choose.onclick = () => finish(path.value.trim());
  path.onkeydown = (event) => {
    if (event.key !== "Enter") return;
    event.preventDefault();
    choose.click();
  };
  model.on("listing", show);
  model.on("recent", showRecent);
  return {
    open(options, then) {
      wanted = options;
      done = then;
      heading.textContent = options.title;
      path.value = options.start || "";
      showRecent();
      problem.textContent = "";
      ask(options.start || "");
      dialog.showModal();
      path.focus();
    },
  };
}
