// Bundles the page: this folder and npm's packages become ../static. `--check` only reports whether that is up to date.
import { createHash } from "node:crypto";
import { copyFileSync, existsSync, mkdirSync, readFileSync, readdirSync, rmSync, writeFileSync } from "node:fs";
import path from "node:path";
import { gzipSync } from "node:zlib";

const PAGE = import.meta.dirname;
const ROOT = path.join(PAGE, "../../..");
const STATIC = path.join(PAGE, "../static");
/** What is also kept packed, for browsers that take it so. */
const PACKED = /\.(js|css|json|svg)$/;
/** What index.html asks for; each file's name gets a hash of its content, so that browsers can keep it for ever. */
const ENTRIES = ["app.js", "lib/early.js", "style/page.css"];
const STAMP = path.join(STATIC, "sources.sha256");

const lock = path.join(ROOT, "package-lock.json");
const files = readdirSync(PAGE, { recursive: true, withFileTypes: true }).filter((entry) => entry.isFile());
/** Sentences that the command line knows, too. */
const SAID = path.join(ROOT, "bench/base/words/told.json");
const sources = [...files.map((entry) => path.join(entry.parentPath, entry.name)), SAID].sort();

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

/** The HTML with the names that its files have got, and those of all modules that app.js imports: they are fetched beside it. */
function named(text, { outputs }) {
  const built = (entry) => Object.keys(outputs).find((file) => outputs[file].entryPoint === `bench/web/page/${entry}`);
  const address = (file) => file.replace("bench/web", "");
  const needed = new Set([built("app.js")]);
  for (const file of needed) for (const { kind, path: other } of outputs[file].imports) if (kind === "import-statement") needed.add(other);
  const links = [...needed].slice(1).map((file) => `  <link rel="modulepreload" href="${address(file)}">\n`).join("");
  return ENTRIES.reduce((html, entry) => html.replace(`/static/${entry}`, address(built(entry))), text).replace("</head>", `${links}</head>`);
}

async function build() {
  const { build: bundle } = await import("esbuild");
  rmSync(STATIC, { recursive: true, force: true });
  const { metafile } = await bundle({
    absWorkingDir: ROOT,
    entryPoints: ENTRIES.map((name) => `bench/web/page/${name}`),
    outbase: "bench/web/page",
    outdir: "bench/web/static",
    entryNames: "[dir]/[name]-[hash]",
    chunkNames: "[name]-[hash]",
    metafile: true,
    bundle: true,
    splitting: true,
    format: "esm",
    target: "es2022",
    minify: true,
    charset: "utf8",
    logLevel: "warning",
  });
  mkdirSync(path.join(STATIC, "style"), { recursive: true });
  copyFileSync(path.join(PAGE, "style/icon.svg"), path.join(STATIC, "style/icon.svg"));
  writeFileSync(path.join(STATIC, "index.html"), named(readFileSync(path.join(PAGE, "index.html"), "utf8"), metafile));
  for (const file of readdirSync(STATIC, { recursive: true, encoding: "utf8" }).filter((name) => PACKED.test(name)))
    writeFileSync(path.join(STATIC, `${file}.gz`), gzipSync(readFileSync(path.join(STATIC, file)), { level: 9 }));
  writeFileSync(path.join(STATIC, "LICENSES.txt"), licences());
  writeFileSync(STAMP, fingerprint());
}

if (!process.argv.includes("--check")) await build();
else if (!existsSync(STAMP) || readFileSync(STAMP, "utf8") !== fingerprint()) process.exitCode = 1;
