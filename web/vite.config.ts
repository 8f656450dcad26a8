import react from "@vitejs/plugin-react";
import { defineConfig } from "vitest/config";

export default defineConfig({
  // Relative addresses: the same build works behind any path a hospital's proxy may put it at.
  base: "./",
  plugins: [react()],
  build: { outDir: "../python/carina/_web", emptyOutDir: true, target: "es2022", chunkSizeWarningLimit: 900 },
  server: {
    proxy: {
      "/ws": { target: "ws://127.0.0.1:8765", ws: true },
      "/api": "http://127.0.0.1:8765",
    },
  },
  test: { environment: "node", include: ["src/**/*.test.{ts,tsx}"] },
});
