"use strict";
// Shows the values of the nearest point of a figure's curves where the pointer is; the curves are in data-hover.
(() => {
  const NEAR = 24;  // pixels
  const note = document.createElement("div"), ring = document.createElement("div");
  note.className = "hover-note";
  ring.className = "hover-ring";
  note.hidden = ring.hidden = true;
  document.body.append(note, ring);
  const hide = () => { note.hidden = ring.hidden = true; };
  const share = (value, [low, high, isLog]) => isLog
    ? Math.log(value / low) / Math.log(high / low) : (value - low) / (high - low);
  const minus = (text) => text.replace(/-/g, "\u2212");

  function nearest(panels, frame, x, y) {
    let found = null, least = NEAR;
    for (const panel of panels) {
      const [left, top, right, bottom] = panel.box;
      const across = (value) => frame.left + frame.width * (left + (right - left) * share(value, panel.x));
      const up = (value) => frame.top + frame.height * (bottom - (bottom - top) * share(value, panel.y));
      for (const [label, xs, ys] of panel.curves)
        xs.forEach((at, i) => {
          const px = across(Number(at)), py = up(Number(ys[i])), far = Math.hypot(px - x, py - y);
          if (far < least) [found, least] = [{panel, label, at, value: ys[i], px, py}, far];
        });
    }
    return found;
  }

  function show(figure, panels, event) {
    const found = nearest(panels, figure.querySelector("svg").getBoundingClientRect(), event.clientX, event.clientY);
    if (!found) return hide();
    const named = (axis, value) => `${axis[3] || "value"}: ${minus(value)}`;
    note.textContent = [found.label, named(found.panel.x, found.at), named(found.panel.y, found.value)].filter(Boolean).join("\n");
    note.hidden = ring.hidden = false;
    ring.style.left = `${found.px - 6}px`;
    ring.style.top = `${found.py - 6}px`;
    const right = window.innerWidth - note.offsetWidth - 8, below = window.innerHeight - note.offsetHeight - 8;
    note.style.left = `${Math.max(4, Math.min(found.px + 14, right))}px`;
    note.style.top = `${Math.max(4, Math.min(found.py + 14, below))}px`;
  }

  for (const figure of document.querySelectorAll("figure[data-hover]")) {
    const panels = JSON.parse(figure.dataset.hover);
    for (const panel of panels) panel.curves = panel.curves.map(([label, xs, ys]) => [label, xs.split(" "), ys.split(" ")]);
    figure.addEventListener("pointermove", (event) => show(figure, panels, event));
    figure.addEventListener("pointerdown", (event) => show(figure, panels, event));
    figure.addEventListener("pointerleave", hide);
  }
  window.addEventListener("scroll", hide, {passive: true, capture: true});
})();
