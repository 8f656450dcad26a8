// Clips over still pictures: each plays on a click or moves by hand, and at its end the still is seen again.
"use strict";
(() => {
  const calm = window.matchMedia("(prefers-reduced-motion: reduce)");
  for (const controls of document.querySelectorAll(".clip")) {
    const strip = controls.querySelector("img"), slider = controls.querySelector("input"), button = controls.querySelector("button");
    const seconds = Number(controls.dataset.seconds), numFrames = Number(slider.max);
    const screen = document.createElement("canvas");
    const paint = screen.getContext && screen.getContext("2d");
    if (!paint) continue;
    // Paper shows the still, wherever the clip stands.
    screen.className = "on-screen";
    screen.hidden = true;
    controls.previousElementSibling.append(screen);
    let began = null;

    /** A frame from 0; after the last the still itself. */
    function show(frame) {
      const side = strip.naturalWidth;
      screen.hidden = frame >= numFrames || side === 0;
      slider.value = String(frame);
      slider.setAttribute("aria-valuetext", screen.hidden ? "at the fork" : `picture ${frame + 1} of ${numFrames}`);
      if (screen.hidden) return;
      if (screen.width !== side) screen.width = screen.height = side;
      paint.drawImage(strip, 0, frame * side, side, side, 0, 0, side, side);
    }

    function stop() {
      began = null;
      button.textContent = button.dataset.play;
    }

    function step(now) {
      if (began === null) return;
      const frame = Math.floor(((now - began) / 1000 / seconds) * numFrames);
      if (frame >= numFrames) stop();
      show(Math.max(0, Math.min(frame, numFrames)));
      if (began !== null) requestAnimationFrame(step);
    }

    button.addEventListener("click", () => {
      if (began !== null) { stop(); return; }
      // From where it was stopped; from the beginning where it is at its end.
      const from = Number(slider.value) % numFrames;
      began = performance.now() - (from / numFrames) * seconds * 1000;
      button.textContent = button.dataset.stop;
      requestAnimationFrame(step);
    });
    slider.addEventListener("input", () => { stop(); show(Number(slider.value)); });
    // Who asks for less motion moves the clip by hand.
    const settle = () => { button.hidden = calm.matches; if (calm.matches && began !== null) { stop(); show(numFrames); } };
    calm.addEventListener("change", settle);
    settle();
    show(numFrames);
    controls.hidden = false;
  }
})();
