/**
 * Linked views of a case in a notebook. The kernel renders; this page sends gestures and shows pictures.
 *
 * At most one request is on its way. Movements in the meantime are added up and sent with the next request, so a slow
 * kernel makes the picture less smooth but never late.
 */

const TURN_RAD_PER_PX = 0.005;
const TURN_RAD_PER_KEY = 0.06;
const ADVANCE_MM_PER_WHEEL = 0.02;
const ADVANCE_MM_PER_KEY = 2;
const STILL_AFTER_MS = 180;
const BUSY_AFTER_MS = 1500;
const KEYS = "drag: look · wheel: forward and back, or through slices · click: show a point · double-click: go there · W, S: forward and back · arrows: look · Space, Shift+Space: next and previous fork · F: slices follow the tip";

/** Gestures that the next request sends. */
class Gestures {
  move = [0, 0, 0, 0];
  actions = [];

  steer(advance, yaw, pitch) {
    this.move[0] += advance;
    this.move[1] += yaw;
    this.move[2] += pitch;
  }

  /** Add a number of slices to a request for the same view, or begin one. */
  slices(view, steps) {
    const last = this.actions.at(-1);
    if (last?.kind === "slices" && last.view === view) last.steps[0] += steps;
    else this.actions.push({ kind: "slices", view, steps: [steps] });
  }

  get isEmpty() {
    return this.actions.length === 0 && this.move.every((part) => part === 0);
  }

  take() {
    const taken = { move: this.move, actions: this.actions };
    this.move = [0, 0, 0, 0];
    this.actions = [];
    return taken;
  }
}

function element(parent, tag, className, text) {
  const made = document.createElement(tag);
  if (className) made.className = className;
  if (text) made.textContent = text;
  parent.append(made);
  return made;
}

function render({ model, el }) {
  const root = element(el, "div", "carina-case-view");
  root.tabIndex = 0;
  root.setAttribute("role", "application");
  root.setAttribute("aria-label", "Views of a CT; the keys are listed below the views");
  // JupyterLab would otherwise take the keys as its own commands.
  root.dataset.lmSuppressShortcuts = "true";
  const grid = element(root, "div", "grid");
  const rows = model.get("views");
  const columns = rows.length === 1 ? 1 : rows.length > 4 ? 3 : 2;
  grid.style.gridTemplateColumns = `repeat(${columns}, minmax(0, 1fr))`;
  grid.style.gridAutoRows = "minmax(0, 1fr)";
  grid.style.height = `${model.get("height")}px`;
  const bar = element(root, "div", "bar");
  const line = element(bar, "span", "line");
  line.setAttribute("aria-live", "polite");
  const badges = element(root, "div", "badges");
  const message = element(root, "div", "message");
  message.setAttribute("role", "status");
  element(root, "div", "keys", KEYS);

  const gestures = new Gestures();
  // A widget can be displayed several times, and each page receives the answers to all of them.
  const page = Math.random().toString(36).slice(2);
  const cells = new Map();
  const timers = new Set();
  let number = 0;
  let waiting = null;
  let isStillDue = true;
  let isStale = true;
  let stillTimer = 0;

  const later = (ms, work) => {
    const timer = setTimeout(() => {
      timers.delete(timer);
      work();
    }, ms);
    timers.add(timer);
    return timer;
  };

  function sizes() {
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    const scale = isStillDue ? ratio : 0.75;
    const found = {};
    for (const [view, cell] of cells) {
      const { width, height } = cell.box.getBoundingClientRect();
      if (width >= 1 && height >= 1) found[view] = [Math.round(width * scale), Math.round(height * scale)];
    }
    return found;
  }

  function send() {
    if (waiting !== null || !(isStale || isStillDue || !gestures.isEmpty)) return;
    const wanted = sizes();
    if (Object.keys(wanted).length === 0) return;
    number += 1;
    const sent = `${page}-${number}`;
    waiting = { number: sent, isStill: isStillDue };
    isStale = false;
    model.send({ number: sent, sizes: wanted, still: isStillDue, ...gestures.take() });
    isStillDue = false;
    later(BUSY_AFTER_MS, () => {
      if (waiting?.number === sent) message.textContent = "The kernel is busy; the views continue when it is free.";
    });
  }

  function moved() {
    clearTimeout(stillTimer);
    timers.delete(stillTimer);
    send();
    stillTimer = later(STILL_AFTER_MS, () => {
      isStillDue = true;
      send();
    });
  }

  function act(action) {
    gestures.actions.push(action);
    isStillDue = true;
    send();
  }

  async function show(content, buffers) {
    const pictures = content.views.map(async (shown, n) => {
      const cell = cells.get(shown.view);
      if (cell === undefined) return;
      cell.problem.textContent = shown.problem ?? "";
      cell.problem.hidden = !shown.problem;
      if (shown.problem) return;
      const bitmap = await createImageBitmap(new Blob([buffers[n]], { type: "image/jpeg" }));
      cell.canvas.width = shown.width;
      cell.canvas.height = shown.height;
      const context = cell.canvas.getContext("2d");
      context.drawImage(bitmap, 0, 0);
      bitmap.close();
      if (shown.crosshair) cross(context, shown);
    });
    await Promise.allSettled(pictures);
    message.textContent = content.problem ?? "";
    if (content.views.length > 0) {
      line.textContent = content.line;
      badges.replaceChildren();
      for (const words of content.badges) element(badges, "div", "", words);
    }
  }

  function cross(context, { crosshair: [column, row], width, height }) {
    const gap = Math.max(6, width / 50);
    context.strokeStyle = "rgba(79, 211, 230, 0.75)";
    context.lineWidth = Math.max(1, width / 500);
    context.beginPath();
    for (const [fromX, fromY, toX, toY] of [
      [0, row, column - gap, row],
      [column + gap, row, width, row],
      [column, 0, column, row - gap],
      [column, row + gap, column, height],
    ]) {
      context.moveTo(fromX, fromY);
      context.lineTo(toX, toY);
    }
    context.stroke();
  }

  function onMessage(content, buffers) {
    if (content.kind === "changed") {
      isStale = true;
      isStillDue = true;
      send();
    } else if (content.kind === "pictures" && content.number === waiting?.number) {
      void show(content, buffers).then(() => {
        waiting = null;
        root.dataset.shown = content.number.split("-")[1];
        send();
      });
    }
  }

  function pixelOf(cell, event) {
    const box = cell.canvas.getBoundingClientRect();
    return [
      ((event.clientX - box.left) / box.width) * cell.canvas.width,
      ((event.clientY - box.top) / box.height) * cell.canvas.height,
    ];
  }

  for (const { view, title, is_plane: isPlane } of rows) {
    const frame = element(grid, "div", "cell");
    frame.dataset.view = view;
    element(frame, "div", "title", title);
    const box = element(frame, "div", "picture");
    const canvas = element(box, "canvas", "");
    const problem = element(box, "div", "problem");
    problem.hidden = true;
    const cell = { box, canvas, problem };
    cells.set(view, cell);
    let dragged = null;
    canvas.addEventListener("pointerdown", (event) => {
      root.focus({ preventScroll: true });
      canvas.setPointerCapture(event.pointerId);
      dragged = [event.clientX, event.clientY];
    });
    canvas.addEventListener("pointermove", (event) => {
      if (dragged === null || view !== "airway") return;
      gestures.steer(0, (event.clientX - dragged[0]) * TURN_RAD_PER_PX, (dragged[1] - event.clientY) * TURN_RAD_PER_PX);
      dragged = [event.clientX, event.clientY];
      moved();
    });
    canvas.addEventListener("pointerup", (event) => {
      const isClick = dragged !== null && Math.hypot(event.clientX - dragged[0], event.clientY - dragged[1]) < 4;
      dragged = null;
      if (isClick && isPlane) act({ kind: "point", view, pixel: pixelOf(cell, event) });
    });
    canvas.addEventListener("pointercancel", () => {
      dragged = null;
    });
    canvas.addEventListener("dblclick", (event) => {
      if (isPlane) act({ kind: "place", view, pixel: pixelOf(cell, event) });
    });
    canvas.addEventListener(
      "wheel",
      (event) => {
        // The page scrolls until the views have been clicked.
        if (document.activeElement !== root || event.ctrlKey) return;
        event.preventDefault();
        const pixels = event.deltaMode === 0 ? event.deltaY : event.deltaY * 30;
        if (isPlane) gestures.slices(view, Math.sign(pixels));
        else gestures.steer(-pixels * ADVANCE_MM_PER_WHEEL, 0, 0);
        moved();
      },
      { passive: false },
    );
  }

  for (const [text, kind] of [
    ["Previous fork", "previous_fork"],
    ["Next fork", "next_fork"],
    ["Slices follow the tip", "follow"],
    ["Undo", "undo"],
  ]) {
    element(bar, "button", "", text).addEventListener("click", () => act({ kind }));
  }

  root.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.altKey || event.metaKey || event.target !== root) return;
    const turns = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
    const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
    if (key in turns) {
      gestures.steer(0, turns[key][0] * TURN_RAD_PER_KEY, turns[key][1] * TURN_RAD_PER_KEY);
      moved();
    } else if (key === "w" || key === "s") {
      gestures.steer(key === "w" ? ADVANCE_MM_PER_KEY : -ADVANCE_MM_PER_KEY, 0, 0);
      moved();
    } else if (key === " ") act({ kind: event.shiftKey ? "previous_fork" : "next_fork" });
    else if (key === "f") act({ kind: "follow" });
    else return;
    event.preventDefault();
    event.stopPropagation();
  });

  model.on("msg:custom", onMessage);
  const watcher = new ResizeObserver(() => {
    isStillDue = true;
    send();
  });
  watcher.observe(grid);
  return () => {
    watcher.disconnect();
    model.off("msg:custom", onMessage);
    for (const timer of timers) clearTimeout(timer);
  };
}

export default { render };
