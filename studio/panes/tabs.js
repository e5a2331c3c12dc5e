// Tabs for pointer, keyboard and screen reader. The panel is the element behind this one.
export function render({ model, el }) {
  const root = document.createElement("div");
  root.className = "tabs";
  root.setAttribute("role", "tablist");
  root.ariaLabel = model.label;
  const memory = `studio-tab-${model.label}`;
  const tabs = model.names.map((name, k) => {
    const tab = document.createElement("button");
    tab.textContent = name;
    tab.setAttribute("role", "tab");
    tab.onclick = () => select(k);
    tab.onkeydown = (event) => {
      const last = tabs.length - 1;
      const to = { ArrowRight: k === last ? 0 : k + 1, ArrowLeft: k ? k - 1 : last, Home: 0, End: last }[event.key];
      if (to === undefined) return;
      event.preventDefault();
      select(to);
      tabs[to].focus();
    };
    root.append(tab);
    return tab;
  });
  const select = (k) => {
    model.active = k;
    try { sessionStorage.setItem(memory, model.names[k]); } catch {}
  };
  const update = () => {
    tabs.forEach((tab, k) => {
      tab.setAttribute("aria-selected", String(k === model.active));
      tab.tabIndex = k === model.active ? 0 : -1;
    });
    const panel = root.getRootNode().host?.nextElementSibling;
    if (!panel) return;
    panel.setAttribute("role", "tabpanel");
    panel.ariaLabel = model.names[model.active];
  };
  model.on("active", update);
  update();
  setTimeout(update);
  let kept = null;
  try { kept = sessionStorage.getItem(memory); } catch {}
  const wanted = model.names.indexOf(kept);
  if (wanted > 0 && wanted !== model.active) model.active = wanted;
  return root;
}
