import { readFileSync } from "node:fs";
import { defineConfig, type Plugin } from "vite";

/** What is shipped in the built assets, and whose licences therefore go with them: all packages but those of the development. */
const lock = JSON.parse(readFileSync(new URL("package-lock.json", import.meta.url), "utf8")) as {
  packages: Record<string, { dev?: boolean }>;
};
const SHIPPED = Object.entries(lock.packages).flatMap(([path, { dev }]) =>
  path && !dev ? [path.replace("node_modules/", "")] : [],
);

function licences(): Plugin {
  const text = (name: string) =>
    `${name}\n\n${readFileSync(new URL(`node_modules/${name}/LICENSE`, import.meta.url), "utf8").trim()}\n`;
  return {
    name: "licences",
    generateBundle() {
      this.emitFile({ type: "asset", fileName: "assets/licences.txt", source: SHIPPED.map(text).join("\n\n") });
    },
  };
}

export default defineConfig({
  plugins: [licences()],
  esbuild: { jsx: "automatic", jsxImportSource: "preact", legalComments: "none" },
  build: {
    target: "es2022",
    // Everything is a file of its own address: the policy of the pages allows no `data:`.
    assetsInlineLimit: 0,
    modulePreload: { polyfill: false },
    chunkSizeWarningLimit: 900,
    rollupOptions: { input: ["index.html", "docs.html"] },
  },
});
