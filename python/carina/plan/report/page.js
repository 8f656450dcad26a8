// Interactive airway tree, rotated by pointer and keyboard. A 2D canvas is used, so that the page needs no WebGL.
// Patient space is LPS (x left, y back, z head). On the screen right x up points to the viewer: nothing is mirrored.
"use strict";
(() => {
  const canvas = document.getElementById("tree");
  const data = JSON.parse(document.getElementById("tree-data").textContent);
  if (!canvas || !canvas.getContext) return;
  const paint = canvas.getContext("2d");
  const COLOURS = { tree: [150, 162, 172], route: [11, 90, 143], drawn: [193, 0, 31], leg: "#d35400", ink: "#14181c" };
  const AXES = [["L", [1, 0, 0]], ["R", [-1, 0, 0]], ["P", [0, 1, 0]], ["A", [0, -1, 0]], ["S", [0, 0, 1]], ["I", [0, 0, -1]]];
  // Degrees: azimuth 0 looks from the front, 90 from the patient's left; elevation above 0 looks from above.
  const VIEWS = { front: [0, 0], back: [180, 0], left: [90, 0], right: [-90, 0], above: [0, 89.9], below: [0, -89.9] };
  const KEYS = { a: "front", p: "back", l: "left", r: "right", s: "above", i: "below" };
  const MARGIN = 34;

  const points = data.branches.flatMap((branch) => branch.points).concat(data.vertices);
  const low = [0, 1, 2].map((axis) => Math.min(...points.map((point) => point[axis])));
  const high = [0, 1, 2].map((axis) => Math.max(...points.map((point) => point[axis])));
  const centre = low.map((value, axis) => (value + high[axis]) / 2);
  const radius = Math.max(...points.map((point) => Math.hypot(...point.map((value, axis) => value - centre[axis]))));
  const half = low.map((value, axis) => (high[axis] - value) / 2);

  let azimuth = 0, elevation = 0, zoom = 1, shift = [0, 0], waiting = false;

  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];

  /** Right, up and towards the viewer, as LPS directions: right x up = towards. */
  function axes() {
    const a = (azimuth * Math.PI) / 180, e = (elevation * Math.PI) / 180;
    const towards = [Math.sin(a) * Math.cos(e), -Math.cos(a) * Math.cos(e), Math.sin(e)];
    const right = [Math.cos(a), Math.sin(a), 0];
    const up = [
      towards[1] * right[2] - towards[2] * right[1],
      towards[2] * right[0] - towards[0] * right[2],
      towards[0] * right[1] - towards[1] * right[0],
    ];
    return { right, up, towards };
  }

  function draw() {
    waiting = false;
    const ratio = window.devicePixelRatio || 1;
    const width = canvas.clientWidth || 600, height = canvas.clientHeight || 460;
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(height * ratio);
    }
    paint.setTransform(ratio, 0, 0, ratio, 0, 0);
    paint.fillStyle = "#ffffff";
    paint.fillRect(0, 0, width, height);
    const { right, up, towards } = axes();
    // The scale does not depend on the azimuth, so the tree keeps its size during a rotation.
    const reach = Math.hypot(half[0], half[1]) || 1;
    const scale = zoom * Math.min((width / 2 - MARGIN) / reach, (height / 2 - MARGIN) / Math.max(half[2], reach * 0.6));
    const place = (point) => {
      const off = [point[0] - centre[0], point[1] - centre[1], point[2] - centre[2]];
      return [width / 2 + shift[0] + scale * dot(off, right), height / 2 + shift[1] - scale * dot(off, up), dot(off, towards)];
    };

    const pieces = [];
    for (const branch of data.branches) {
      const placed = branch.points.map(place);
      const colour = branch.found ? (branch.route ? COLOURS.route : COLOURS.tree) : COLOURS.drawn;
      for (let n = 1; n < placed.length; n++) {
        const wide = Math.max(scale * (branch.radius[n] + branch.radius[n - 1]), 1.2);
        pieces.push({ depth: (placed[n][2] + placed[n - 1][2]) / 2, kind: "tube", from: placed[n - 1], to: placed[n], wide, colour });
      }
    }
    const vertices = data.vertices.map(place);
    for (const quad of data.quads) {
      const corners = quad.map((index) => vertices[index]);
      pieces.push({ depth: corners.reduce((sum, corner) => sum + corner[2], 0) / 4, kind: "face", corners });
    }
    if (data.needle.length === 2) {
      const [tip, aim] = data.needle.map(place);
      const mix = (t) => tip.map((value, axis) => value + t * (aim[axis] - value));
      for (let n = 0; n < 16; n++) {
        const [from, to] = [mix(n / 16), mix((n + 1) / 16)];
        pieces.push({ depth: (from[2] + to[2]) / 2 + 1, kind: "line", from, to, wide: 3.5, colour: COLOURS.leg });
      }
    }
    pieces.sort((a, b) => a.depth - b.depth);
    for (const piece of pieces) {
      const far = Math.max(0, Math.min(1, (radius - piece.depth) / (2 * radius)));
      if (piece.kind === "tube") tube(piece, far);
      else if (piece.kind === "line") stroke(piece.from, piece.to, piece.wide, piece.colour, "round");
      else face(piece.corners);
    }
    const letters = {};
    for (const [letter, direction] of AXES) {
      const at = place(centre.map((value, axis) => value + direction[axis] * (half[axis] + 7)));
      const across = Math.hypot(dot(direction, right), dot(direction, up));
      // An axis that points at the viewer or away has no direction in the picture, so its letter is omitted.
      if (across < 0.25) continue;
      const spot = [clamp(at[0], 12, width - 12), clamp(at[1], 14, height - 12)];
      letters[letter] = [spot[0], spot[1]];
      paint.globalAlpha = 0.35 + 0.65 * across;
      word(letter, spot[0], spot[1] + 6, "bold 17px Arial, sans-serif", COLOURS.ink, "center");
      paint.globalAlpha = 1;
    }
    const named = [];
    for (const branch of data.branches) {
      if (!branch.route || !branch.name) continue;
      const at = place(branch.points[Math.floor(branch.points.length / 2)]);
      // A name that would overlap another one is omitted at this scale and angle.
      if (named.some((other) => Math.abs(other[0] - at[0]) < 44 && Math.abs(other[1] - at[1]) < 14)) continue;
      named.push(at);
      word(branch.name, at[0] + 9, at[1] + 4, "12px Arial, sans-serif", "#0b5a8f", "left");
    }
    const bar = 20 * scale;
    stroke([width - 14 - bar, height - 12], [width - 14, height - 12], 2, COLOURS.ink, "butt");
    word("20 mm", width - 14, height - 18, "12px Arial, sans-serif", COLOURS.ink, "right");
    canvas.dataset.letters = JSON.stringify(letters);
    canvas.dataset.view = JSON.stringify({ azimuth, elevation, zoom });
  }

  function tube(piece, far) {
    const pale = 0.55 * far;
    const shade = (share) => `rgb(${piece.colour.map((value) => Math.round((value * share) * (1 - pale) + 255 * pale)).join(",")})`;
    stroke(piece.from, piece.to, piece.wide + 1.6, shade(0.55), "butt");
    stroke(piece.from, piece.to, piece.wide, shade(0.9), "round");
    if (piece.wide > 3) {
      const light = -0.18 * piece.wide;
      stroke([piece.from[0] + light, piece.from[1] + light], [piece.to[0] + light, piece.to[1] + light], 0.3 * piece.wide, shade(1.18), "round");
    }
  }

  function face(corners) {
    paint.globalAlpha = 0.2;
    paint.fillStyle = COLOURS.leg;
    paint.beginPath();
    corners.forEach((corner, n) => (n ? paint.lineTo(corner[0], corner[1]) : paint.moveTo(corner[0], corner[1])));
    paint.fill();
    paint.globalAlpha = 1;
  }

  function stroke(from, to, wide, colour, cap) {
    paint.strokeStyle = colour;
    paint.lineWidth = wide;
    paint.lineCap = cap;
    paint.beginPath();
    paint.moveTo(from[0], from[1]);
    paint.lineTo(to[0], to[1]);
    paint.stroke();
  }

  function word(text, x, y, font, colour, align) {
    paint.font = font;
    paint.textAlign = align;
    paint.lineJoin = "round";
    paint.strokeStyle = "#ffffff";
    paint.lineWidth = 4;
    paint.strokeText(text, x, y);
    paint.fillStyle = colour;
    paint.fillText(text, x, y);
  }

  const clamp = (value, least, most) => Math.max(least, Math.min(most, value));

  function redraw() {
    elevation = clamp(elevation, -89.9, 89.9);
    zoom = clamp(zoom, 0.5, 12);
    if (!waiting) { waiting = true; requestAnimationFrame(draw); }
  }

  function look(name) {
    [azimuth, elevation] = VIEWS[name];
    shift = [0, 0];
    zoom = 1;
    redraw();
  }

  let held = null;
  canvas.addEventListener("pointerdown", (event) => {
    held = [event.clientX, event.clientY];
    canvas.setPointerCapture(event.pointerId);
    canvas.focus({ preventScroll: true });
  });
  canvas.addEventListener("pointermove", (event) => {
    if (!held) return;
    const [dx, dy] = [event.clientX - held[0], event.clientY - held[1]];
    held = [event.clientX, event.clientY];
    if (event.shiftKey) shift = [shift[0] + dx, shift[1] + dy];
    else { azimuth -= 0.5 * dx; elevation += 0.5 * dy; }
    redraw();
  });
  for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, () => { held = null; });
  canvas.addEventListener("wheel", (event) => {
    // The wheel scrolls the page unless the tree has the focus.
    if (document.activeElement !== canvas && !event.ctrlKey) return;
    event.preventDefault();
    zoom *= Math.exp(-0.0015 * event.deltaY);
    redraw();
  }, { passive: false });
  canvas.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
    if (key === "ArrowLeft") azimuth += 5;
    else if (key === "ArrowRight") azimuth -= 5;
    else if (key === "ArrowUp") elevation -= 5;
    else if (key === "ArrowDown") elevation += 5;
    else if (key === "+" || key === "=") zoom *= 1.15;
    else if (key === "-") zoom /= 1.15;
    else if (key === "0" || key === "Home") { look("front"); }
    else if (key in KEYS) { look(KEYS[key]); }
    else return;
    event.preventDefault();
    redraw();
  });
  for (const button of document.querySelectorAll("button[data-look]")) {
    button.addEventListener("click", () => look(button.dataset.look));
  }
  window.addEventListener("resize", redraw);
  draw();
})();
