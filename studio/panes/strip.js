// Strip with the active deviations of the lens. Without any, it takes no space.
export function render({ model, el }) {
  const root = document.createElement("div");
  root.className = "strip";
  root.setAttribute("role", "status");
  const words = document.createElement("span");
  const where = document.createElement("small");
  where.textContent = "acts on wavefront, PSF, MTF, contrast and patch";
  const reset = document.createElement("button");
  reset.textContent = "reset";
  reset.title = reset.ariaLabel = "Set all deviations to 0";
  reset.onclick = () => model.send_msg({ action: "reset" });
  root.append(words, reset, where);
  const update = () => {
    root.hidden = !model.words;
    words.textContent = `What if: ${model.words} · `;
  };
  model.on("words", update);
  update();
  return root;
}
