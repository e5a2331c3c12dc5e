// Faults of a page in accessibility: names of controls, roles, contrast of text, size of targets.
() => {
  const faults = [];
  const all = [];
  const walk = (root) => {
    for (const node of root.children) { all.push(node); if (node.shadowRoot) walk(node.shadowRoot); walk(node); }
  };
  walk(document.body);
  const parentOf = (node) => node.assignedSlot || node.parentElement || node.getRootNode().host || null;
  const chain = (node) => { const found = []; for (let at = node; at; at = parentOf(at)) found.push(at); return found; };
  const isShown = (node) => {
    const box = node.getBoundingClientRect();
    if (!box.width || !box.height) return false;
    return chain(node).every((at) => {
      const style = getComputedStyle(at);
      return style.display !== "none" && style.visibility !== "hidden" && Number(style.opacity) > 0;
    });
  };
  const words = (node) => (node.innerText || node.textContent || "").trim();
  const say = (node, what) => {
    const name = node.ariaLabel || words(node).slice(0, 40) || node.className;
    faults.push(`${what}: ${node.tagName.toLowerCase()} "${name}"`);
  };

  // Every control has a name, which is not only a placeholder.
  const controls = all.filter((node) => node.matches("input, select, textarea, button, a[href], [role=tab], [tabindex='0']"));
  const labelOf = (node) => {
    const root = node.getRootNode();
    const by = (node.getAttribute("aria-labelledby") || "").split(/\s+/).filter(Boolean).map((id) => root.getElementById(id));
    if (by.some(Boolean)) return by.map((one) => one && words(one)).join(" ");
    if (node.ariaLabel) return node.ariaLabel;
    if (node.labels && node.labels.length) return [...node.labels].map(words).join(" ");
    const own = node.id && root.querySelector(`label[for="${CSS.escape(node.id)}"]`);
    if (own) return words(own);
    return node.matches("input, select, textarea") ? "" : words(node) || node.title || [...node.querySelectorAll("img")].map((one) => one.alt).join(" ");
  };
  for (const node of controls) {
    if (!isShown(node) || node.type === "hidden") continue;
    if (!labelOf(node).trim() && node.tagName !== "DIV") say(node, "no name");
    if (node.tagName === "DIV" && !node.getAttribute("role")) say(node, "focusable without a role");
  }
  const names = new Map();
  for (const node of controls.filter((one) => isShown(one) && one.matches("input:not([type=checkbox]), select"))) {
    const name = labelOf(node).trim();
    names.set(name, (names.get(name) || 0) + 1);
  }
  for (const [name, count] of names) if (count > 1) faults.push(`${count} fields have the name "${name}"`);

  // Landmarks, tabs, charts and dialogs have their roles.
  for (const tag of ["header", "main"]) if (all.filter((one) => one.matches(tag)).length < 1) faults.push(`no ${tag}`);
  for (const list of all.filter((one) => one.matches("[role=tablist]"))) {
    const tabs = [...list.querySelectorAll("[role=tab]")];
    if (!list.ariaLabel) say(list, "tab list without a name");
    if (tabs.filter((one) => one.getAttribute("aria-selected") === "true").length !== 1) say(list, "not one tab is selected");
    if (tabs.filter((one) => one.tabIndex === 0).length !== 1) say(list, "not one tab is in the order of the Tab key");
  }
  const panels = all.filter((one) => one.matches("[role=tabpanel]"));
  if (panels.length !== all.filter((one) => one.matches("[role=tablist]")).length) faults.push("a tab panel is missing");
  for (const panel of panels) if (!panel.ariaLabel) say(panel, "tab panel without a name");
  for (const node of all.filter((one) => one.matches("img, iframe, dialog, .bk-Figure"))) {
    const name = node.alt || node.title || labelOf(node);
    if (isShown(node) && !name) say(node, "picture without a name");
  }
  if (!document.documentElement.lang) faults.push("the page has no language");

  // Contrast of text with its background.
  const parsed = (text) => {
    const [r, g, b, a = 1] = text.match(/[\d.]+/g).map(Number);
    return [r, g, b, a];
  };
  const over = (top, below) => [0, 1, 2].map((k) => top[k] * top[3] + below[k] * (1 - top[3])).concat(1);
  const backgroundOf = (node) => {
    const layers = [];
    for (const at of chain(node)) {
      const own = parsed(getComputedStyle(at).backgroundColor);
      if (own[3]) layers.push(own);
      if (own[3] === 1) break;
    }
    return layers.reverse().reduce((below, top) => over(top, below), [255, 255, 255, 1]);
  };
  const luminance = (color) => {
    const [r, g, b] = color.slice(0, 3).map((v) => v / 255).map((v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4));
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const ratio = (one, other) => {
    const [low, high] = [luminance(one), luminance(other)].sort((a, b) => a - b);
    return (high + 0.05) / (low + 0.05);
  };
  const isOff = (node) => chain(node).some((at) => at.disabled || at.ariaDisabled === "true");
  const check = (node, style, what) => {
    const background = backgroundOf(node);
    const opacity = chain(node).reduce((product, at) => product * Number(getComputedStyle(at).opacity), 1);
    const color = parsed(style.color);
    const found = ratio(over([...color.slice(0, 3), color[3] * opacity], background), background);
    if (found < 4.5) say(node, `contrast ${found.toFixed(2)} of ${what}`);
  };
  for (const node of all) {
    if (node.matches("script, style, option, datalist, canvas") || !isShown(node) || isOff(node)) continue;
    const hasText = [...node.childNodes].some((one) => one.nodeType === 3 && one.data.trim());
    if (hasText || (node.matches("input, select, textarea") && node.value && node.type !== "range" && node.type !== "checkbox"))
      check(node, getComputedStyle(node), "text");
    if (node.placeholder && !node.value) check(node, getComputedStyle(node, "::placeholder"), "placeholder");
  }

  // Targets are at least 24 pixels wide and high; a label belongs to the target of its box. Links within a text have
  // the height of its lines (WCAG 2.2, 2.5.8), and a link above the window comes down when it has the focus.
  const isInText = (node) => node.matches("a") && node.closest("p, li, td, dt, dd, figcaption, caption, h1, h2, h3") && !node.closest("nav");
  for (const node of controls) {
    if (!isShown(node) || node.disabled || node.tagName === "DIV" || isInText(node)) continue;
    if (node.getBoundingClientRect().bottom <= 0) continue;
    const boxes = [node, ...(node.labels || [])].map((one) => one.getBoundingClientRect());
    const width = Math.max(...boxes.map((box) => box.width)), height = Math.max(...boxes.map((box) => box.height));
    if (Math.min(width, height) < 23.9) say(node, `target of ${width.toFixed(0)} by ${height.toFixed(0)} pixels`);
  }
  if (document.documentElement.scrollWidth > innerWidth) faults.push(`wider than the window by ${document.documentElement.scrollWidth - innerWidth}`);
  return [...new Set(faults)];
}
