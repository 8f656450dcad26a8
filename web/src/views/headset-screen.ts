/**
 * Virtual screen in the headset that shows the latest airway picture. The screen is drawn at the headset's frame rate;
 * a slow renderer delays the picture but not the response to head movement.
 */

import type { HeadsetScreen, XrSession, XrTransform, XrView, XrViewerPose } from "../input/devices/webxr";
import fragmentText from "./shaders/screen.frag?raw";
import vertexText from "./shaders/screen.vert?raw";

/** Distance of the screen from the head, m. The screen has a visual angle of about 55 degrees, as a near monitor. */
const AWAY_M = 1.5;
/** Half the height of the screen, m. */
const HALF_M = 0.8;

/** The latest airway picture; `frameId` changes with each new picture. */
export interface LatestPicture {
  readonly image: TexImageSource & { readonly width: number; readonly height: number };
  readonly frameId: number;
  readonly round: boolean;
}

/** The part of the browser's `XRWebGLLayer` that Carina uses. */
export interface XrLayer {
  readonly framebuffer: WebGLFramebuffer | null;
  getViewport(view: XrView): { x: number; y: number; width: number; height: number } | null;
}

/** Page functions that {@link PictureScreen} uses; tests supply fakes. */
export interface ScreenHooks {
  latest(): LatestPicture | null;
  canvas(): HTMLCanvasElement;
  layer(session: XrSession, gl: WebGL2RenderingContext): XrLayer;
}

/** Return the product a b of two column-major 4x4 matrices, as WebGL uses them. */
export function product(a: ArrayLike<number>, b: ArrayLike<number>): Float32Array {
  const found = new Float32Array(16);
  for (let column = 0; column < 4; column += 1) {
    for (let row = 0; row < 4; row += 1) {
      let sum = 0;
      for (let n = 0; n < 4; n += 1) sum += (a[4 * n + row] ?? 0) * (b[4 * column + n] ?? 0);
      found[4 * column + row] = sum;
    }
  }
  return found;
}

/**
 * Return the column-major matrix `room_from_screen` of an upright screen in front of the head, at the height of the
 * head.
 */
export function inFrontOf(head: Pick<XrTransform, "matrix">, aspect: number): Float32Array {
  const m = head.matrix;
  // The head looks along -z of its matrix. The vertical part of the direction is ignored. For a head that looks
  // straight up, the screen is in direction -z of the room.
  let [x, z] = [-(m[8] ?? 0), -(m[10] ?? -1)];
  const flat = Math.hypot(x, z);
  [x, z] = flat < 1e-3 ? [0, -1] : [x / flat, z / flat];
  const [wide, high] = aspect >= 1 ? [HALF_M * aspect, HALF_M] : [HALF_M, HALF_M / aspect];
  const [px, py, pz] = [(m[12] ?? 0) + AWAY_M * x, m[13] ?? 0, (m[14] ?? 0) + AWAY_M * z];
  // The x axis of the screen is perpendicular to the viewing direction, and its z axis points to the head.
  return new Float32Array([-z * wide, 0, x * wide, 0, 0, high, 0, 0, -x, 0, -z, 0, px, py, pz, 1]);
}

/** Virtual screen that WebGL draws in the headset. */
export class PictureScreen implements HeadsetScreen {
  readonly #hooks: ScreenHooks;
  #gl: WebGL2RenderingContext | null = null;
  #layer: XrLayer | null = null;
  #program: WebGLProgram | null = null;
  #texture: WebGLTexture | null = null;
  #uploaded: number | null = null;
  /** Pose of the head when the screen was last placed; null until the screen is placed. */
  #head: Pick<XrTransform, "matrix"> | null = null;

  constructor(hooks: ScreenHooks) {
    this.#hooks = hooks;
  }

  async open(session: XrSession): Promise<void> {
    const canvas = this.#hooks.canvas();
    const gl = canvas.getContext("webgl2", { xrCompatible: true, antialias: true, alpha: false });
    if (gl === null) throw new Error("this browser does not support WebGL 2");
    await (gl as { makeXRCompatible?: () => Promise<void> }).makeXRCompatible?.();
    this.#gl = gl;
    this.#program = linked(gl);
    this.#texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, this.#texture);
    for (const [name, value] of [
      [gl.TEXTURE_MIN_FILTER, gl.LINEAR],
      [gl.TEXTURE_MAG_FILTER, gl.LINEAR],
      [gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE],
      [gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE],
    ] as const) {
      gl.texParameteri(gl.TEXTURE_2D, name, value);
    }
    this.#layer = this.#hooks.layer(session, gl);
    session.updateRenderState({ baseLayer: this.#layer });
  }

  draw(viewer: XrViewerPose): void {
    const gl = this.#gl;
    const layer = this.#layer;
    if (gl === null || layer === null) return;
    gl.bindFramebuffer(gl.FRAMEBUFFER, layer.framebuffer);
    gl.clearColor(0.055, 0.067, 0.075, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const latest = this.#hooks.latest();
    if (latest === null || latest.image.width === 0 || latest.image.height === 0) return;
    // biome-ignore lint/correctness/useHookAtTopLevel: a method of WebGL, not a hook of React
    gl.useProgram(this.#program);
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, this.#texture);
    if (this.#uploaded !== latest.frameId) {
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, latest.image);
      this.#uploaded = latest.frameId;
    }
    // Copy the matrix, because WebXR may reuse the array of a frame.
    this.#head ??= { matrix: Float32Array.from(viewer.transform.matrix) };
    // Use the aspect ratio of the current picture, because the layout of the page may change it and a round lumen must
    // stay round.
    const room = inFrontOf(this.#head, latest.image.width / latest.image.height);
    gl.uniform1i(gl.getUniformLocation(this.#program as WebGLProgram, "is_round"), latest.round ? 1 : 0);
    const place = gl.getUniformLocation(this.#program as WebGLProgram, "eye_from_screen");
    for (const view of viewer.views) {
      const viewport = layer.getViewport(view);
      if (viewport === null) continue;
      gl.viewport(viewport.x, viewport.y, viewport.width, viewport.height);
      const eye = product(view.projectionMatrix, product(view.transform.inverse.matrix, room));
      gl.uniformMatrix4fv(place, false, eye);
      gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
    }
  }

  recenter(): void {
    this.#head = null;
  }

  close(): void {
    const gl = this.#gl;
    if (gl !== null) {
      gl.deleteTexture(this.#texture);
      gl.deleteProgram(this.#program);
    }
    this.#gl = this.#layer = this.#program = this.#texture = this.#uploaded = this.#head = null;
  }
}

function linked(gl: WebGL2RenderingContext): WebGLProgram {
  const program = gl.createProgram();
  for (const [kind, text] of [
    [gl.VERTEX_SHADER, vertexText],
    [gl.FRAGMENT_SHADER, fragmentText],
  ] as const) {
    const shader = gl.createShader(kind);
    if (shader === null) throw new Error("the graphics context was lost");
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
    gl.deleteShader(shader);
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) {
    throw new Error(`the screen of the headset could not be created: ${gl.getProgramInfoLog(program) ?? ""}`);
  }
  return program;
}
