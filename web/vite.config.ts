/// <reference types="vitest/config" />
import { fileURLToPath } from "node:url";
import react from "@vitejs/plugin-react";
import { defineConfig } from "vite";

const page = (name: string) => fileURLToPath(new URL(name, import.meta.url));

/** A running `carina`, to whom the pages served here are a program that shows its token, not a strange site. */
const address = process.env.CARINA_ADDRESS ?? "http://127.0.0.1:8765";
const real = {
  target: address,
  changeOrigin: true,
  headers: { origin: address, authorization: `Bearer ${process.env.CARINA_TOKEN ?? ""}` },
};

export default defineConfig({
  // Relative addresses: the same build works behind any path a hospital's proxy may put it at.
  base: "./",
  plugins: [react()],
  build: {
    outDir: "../python/carina/_web",
    emptyOutDir: true,
    target: "es2022",
    chunkSizeWarningLimit: 900,
    modulePreload: { polyfill: false },
    rolldownOptions: {
      input: { index: page("index.html"), phone: page("phone.html") },
      output: {
        // What both pages read lies in a file of its own, which the phone's server hands out too: by its name.
        manualChunks: (id: string) =>
          (/\/src\/(wire|net)\//.test(id) && !id.endsWith("/wire/views.ts")) || id.endsWith("schema.json")
            ? "phone-wire"
            : undefined,
      },
    },
  },
  server: {
    proxy: {
      "/ws": { ...real, ws: true },
      "/api": real,
    },
  },
  // One environment for all files: they share no state, and a new one for each took ten times as long as the tests.
  // Tests wait for nothing: the limit is for what hangs, however little of the processor others leave.
  test: { environment: "node", include: ["src/**/*.test.{ts,tsx}"], isolate: false, testTimeout: 120_000 },
});
