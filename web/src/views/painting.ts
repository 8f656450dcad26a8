/** Record of the scene values that an overlay has read; the overlay is repainted only if one of them changes. */

import type { Scene } from "./scene";

/** Record of one painting of an overlay. */
export class Painting {
  readonly #version: number;
  readonly #read = new Map<keyof Scene, unknown>();

  /** Record the version of the picture. */
  constructor(of: { readonly version: number }) {
    this.#version = of.version;
  }

  /** Return a proxy of the scene that records each value that is read. */
  watched(scene: Scene): Scene {
    return new Proxy(scene, {
      get: (target, key) => {
        const value = Reflect.get(target, key);
        this.#read.set(key as keyof Scene, value);
        return value;
      },
    });
  }

  /** Return whether repainting would draw the same. */
  holds(of: { readonly version: number }, scene: Scene): boolean {
    if (of.version !== this.#version) return false;
    for (const [key, value] of this.#read) if (!Object.is(scene[key], value)) return false;
    return true;
  }
}
