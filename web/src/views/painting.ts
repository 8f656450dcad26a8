/**
 * Record of the scene values that an overlay has read. The overlay is repainted only if one of these values changes.
 */

import type { Scene } from "./scene";

/** Record of the scene values that one painting of an overlay has read. */
export class Painting {
  readonly #version: number;
  readonly #read = new Map<keyof Scene, unknown>();

  /** Record the version of the viewport's picture at the painting. */
  constructor(of: { readonly version: number }) {
    this.#version = of.version;
  }

  /** Return a proxy of the scene that records each value that the overlay reads. */
  watched(scene: Scene): Scene {
    return new Proxy(scene, {
      get: (target, key) => {
        const value = Reflect.get(target, key);
        this.#read.set(key as keyof Scene, value);
        return value;
      },
    });
  }

  /** Return whether the painting is still valid: neither the picture's version nor a recorded value has changed. */
  holds(of: { readonly version: number }, scene: Scene): boolean {
    if (of.version !== this.#version) return false;
    for (const [key, value] of this.#read) if (!Object.is(scene[key], value)) return false;
    return true;
  }
}
