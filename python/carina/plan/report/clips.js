// Clips over still pictures: a button or a slider plays each clip, and the still picture is visible at the end.
"use strict";
(() => {
  const calm = window.matchMedia("(prefers-reduced-motion: reduce)");
  for (const controls of document.querySelectorAll(".clip")) {
    const strip = controls.querySelector("img"), slider = controls.querySelector("input"), button = controls.querySelector("button");
    const seconds = Number(controls.dataset.seconds), numFrames = Number(slider.max);
    const screen = document.createElement("canvas");
    const paint = screen.getContext && screen.getContext("2d");
    if (!paint) continue;
    // The printed page always shows the still picture.
    screen.className = "on-screen";
    screen.hidden = true;
    controls.previousElementSibling.append(screen);
    let began = null;

    /** Show frame `frame`, counted from 0; after the last frame show the still picture. */
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
      // The clip continues at its position; at the end it starts again from the beginning.
      const from = Number(slider.value) % numFrames;
      began = performance.now() - (from / numFrames) * seconds * 1000;
      button.textContent = button.dataset.stop;
      requestAnimationFrame(step);
    });
    slider.addEventListener("input", () => { stop(); show(Number(slider.value)); });
    // With reduced motion there is no play button, only the slider.
    const settle = () => { button.hidden = calm.matches; if (calm.matches && began !== null) { stop(); show(numFrames); } };
    calm.addEventListener("change", settle);
    settle();
    show(numFrames);
    controls.hidden = false;
  }
})();
