// Path of a file or folder: a box with a button that opens the dialog, or buttons alone.
export function render({ model, el }) {
  const root = document.createElement("div");
  root.className = "files";
  const picker = filePicker(model, root);
  const choose = (mode, title, start, then) =>
    picker.open({ mode, title, start, suffixes: model.suffixes }, then);
  const button = (text, hint, act) => {
    const node = document.createElement("button");
    node.textContent = text;
    node.title = node.ariaLabel = hint;
    node.onclick = act;
    root.append(node);
  };
  if (model.label) {
    const label = document.createElement("label");
    const words = document.createElement("span");
    words.textContent = model.label;
    const box = document.createElement("input");
    box.type = "text";
    box.spellcheck = false;
    box.placeholder = model.placeholder;
    box.onchange = () => { model.value = box.value.trim(); };
    label.append(words, box);
    root.append(label);
    const show = () => { box.value = model.value; };
    model.on("value", show);
    show();
    button("Browse…", `Choose: ${model.label}`, () =>
      choose(model.mode, model.label, model.value, (path) => { model.value = path; }));
  }
  for (const [action, text, mode, hint] of model.actions)
    button(text, hint, () =>
      choose(mode, hint, mode === "save" ? model.suggestion : "", (path) => model.send_msg({ action, path })));
  return root;
}
