/** What was read of the scene for what is drawn over a picture: as long as that is the same, so is the drawing. */

import type { Scene } from "./scene";

export class Painting {
  readonly #version: number;
  readonly #read = new Map<keyof Scene, unknown>();

  /** Of a picture as it is now. */
  constructor(of: { readonly version: number }) {
    this.#version = of.version;
  }

  /** The scene for whoever paints; each part that is read is remembered. */
  watched(scene: Scene): Scene {
    return new Proxy(scene, {
      get: (target, key) => {
        const value = Reflect.get(target, key);
        this.#read.set(key as keyof Scene, value);
        return value;
      },
    });
  }

  /** Whether painting again would draw the same. */
  holds(of: { readonly version: number }, scene: Scene): boolean {
    if (of.version !== this.#version) return false;
    for (const [key, value] of this.#read) if (!Object.is(scene[key], value)) return false;
    return true;
  }
}
