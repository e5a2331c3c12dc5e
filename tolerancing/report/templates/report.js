(() => {
  "use strict";
  const root = document.documentElement;
  document.getElementById("theme").addEventListener("click", () => {
    const preferred = matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light";
    root.dataset.theme = (root.dataset.theme || preferred) === "dark" ? "light" : "dark";
  });
  const texts = JSON.parse(document.getElementById("trials").textContent);
  const tip = document.getElementById("tip");
  const byTrial = new Map();
  for (const circle of document.querySelectorAll("circle[data-trial]")) {
    const trial = circle.dataset.trial;
    if (!byTrial.has(trial)) byTrial.set(trial, []);
    byTrial.get(trial).push(circle);
  }
  let shown = null;
  const show = (trial, x, y) => {
    if (trial !== shown) {
      for (const circle of byTrial.get(shown) || []) circle.classList.remove("hot");
      for (const circle of byTrial.get(trial) || []) circle.classList.add("hot");
      shown = trial;
    }
    if (trial === null) { tip.style.display = "none"; return; }
    tip.textContent = texts[trial] || `trial ${trial}`;
    tip.style.display = "block";
    tip.style.left = Math.max(4, Math.min(x + 12, innerWidth - tip.offsetWidth - 4)) + "px";
    tip.style.top = (y + 16 + tip.offsetHeight > innerHeight ? y - tip.offsetHeight - 10 : y + 16) + "px";
  };
  // The nearest point is selected, so that small points can be hit with a finger.
  const nearest = (svg, event, reach) => {
    const matrix = svg.getScreenCTM();
    if (!matrix) return null;
    const pointer = new DOMPoint(event.clientX, event.clientY).matrixTransform(matrix.inverse());
    let best = null, least = (reach / matrix.a) ** 2;
    for (const circle of svg.querySelectorAll("circle[data-trial]")) {
      const d = (circle.getAttribute("cx") - pointer.x) ** 2 + (circle.getAttribute("cy") - pointer.y) ** 2;
      if (d < least) { least = d; best = circle.dataset.trial; }
    }
    return best;
  };
  const over = (event, reach) => {
    const svg = event.target.closest("svg");
    show(svg ? nearest(svg, event, reach) : null, event.clientX, event.clientY);
  };
  let waiting = false;
  document.addEventListener("pointermove", (event) => {
    if (event.pointerType === "touch" || waiting) return;
    waiting = true;
    requestAnimationFrame(() => { waiting = false; over(event, 8); });
  });
  document.addEventListener("click", (event) => over(event, 16));
  document.addEventListener("scroll", () => show(null), { passive: true });
})();
