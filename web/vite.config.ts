/// <reference types="vitest/config" />
import { fileURLToPath } from "node:url";
import react from "@vitejs/plugin-react";
import { defineConfig } from "vite";

const page = (name: string) => fileURLToPath(new URL(name, import.meta.url));

/**
 * Address of a running `carina`. Requests proxied from the development server carry the program's token, so that Carina
 * does not reject them as cross-site requests.
 */
const address = process.env.CARINA_ADDRESS ?? "http://127.0.0.1:8765";
const real = {
  target: address,
  changeOrigin: true,
  headers: { origin: address, authorization: `Bearer ${process.env.CARINA_TOKEN ?? ""}` },
};

export default defineConfig({
  // Relative addresses, so that the same build works under any path of a reverse proxy.
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
        // Modules used by both pages are bundled into one chunk with a fixed name, which the phone's server also
        // serves.
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
  // All test files share one environment, because a new one per file took ten times as long as the tests. The timeout
  // only stops a hanging test, even on a busy computer.
  test: { environment: "node", include: ["src/**/*.test.{ts,tsx}"], isolate: false, testTimeout: 120_000 },
});
