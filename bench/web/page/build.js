// Bundles the page: this folder and npm's packages become ../static. `--check` only reports whether that is up to date.
import { createHash } from "node:crypto";
import { existsSync, readFileSync, readdirSync, rmSync, writeFileSync } from "node:fs";
import path from "node:path";
import { gzipSync } from "node:zlib";

const PAGE = import.meta.dirname;
const ROOT = path.join(PAGE, "../../..");
const STATIC = path.join(PAGE, "../static");
/** What is also kept packed, for browsers that take it so. */
const PACKED = /\.(js|css|json|svg)$/;
const STAMP = path.join(STATIC, "sources.sha256");

const lock = path.join(ROOT, "package-lock.json");
const files = readdirSync(PAGE, { recursive: true, withFileTypes: true }).filter((entry) => entry.isFile());
const sources = files.map((entry) => path.join(entry.parentPath, entry.name)).sort();

/** Changes with every file that the page is built from. */
function fingerprint() {
  const hash = createHash("sha256");
  for (const file of [lock, ...sources]) {
    const content = readFileSync(file);
    hash.update(`${path.relative(ROOT, file).replaceAll(path.sep, "/")} ${content.length}\n`).update(content);
  }
  return hash.digest("hex");
}

/** Licences of what is bundled. */
function licences() {
  const { esbuild: _, ...bundled } = JSON.parse(readFileSync(path.join(ROOT, "package.json"), "utf8")).dependencies;
  return Object.entries(bundled).map(([name, version]) => {
    const text = readFileSync(path.join(ROOT, "node_modules", name, "LICENSE"), "utf8");
    return `${name} ${version}\n\n${text}`;
  }).join(`\n${"=".repeat(72)}\n\n`);
}

async function build() {
  const { build: bundle } = await import("esbuild");
  rmSync(STATIC, { recursive: true, force: true });
  await bundle({
    absWorkingDir: ROOT,
    entryPoints: [
      "app.js",
      "lib/early.js",
      "index.html",
      "style/page.css",
      "style/icon.svg",
      "words/*.json",
    ].map((name) => `bench/web/page/${name}`),
    outbase: "bench/web/page",
    outdir: "bench/web/static",
    chunkNames: "[name]-[hash]",
    loader: { ".html": "copy", ".svg": "copy", ".json": "copy" },
    bundle: true,
    splitting: true,
    format: "esm",
    target: "es2022",
    minify: true,
    logLevel: "warning",
  });
  for (const file of readdirSync(STATIC, { recursive: true, encoding: "utf8" }).filter((name) => PACKED.test(name)))
    writeFileSync(path.join(STATIC, `${file}.gz`), gzipSync(readFileSync(path.join(STATIC, file)), { level: 9 }));
  writeFileSync(path.join(STATIC, "LICENSES.txt"), licences());
  writeFileSync(STAMP, fingerprint());
}

if (!process.argv.includes("--check")) await build();
else if (!existsSync(STAMP) || readFileSync(STAMP, "utf8") !== fingerprint()) process.exitCode = 1;
