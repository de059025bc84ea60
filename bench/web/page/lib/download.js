// Files that the page makes itself: a table as CSV, a drawing as SVG or PNG.

/** A word that is safe in a file name on every system. */
export const fileName = (text) => text.replace(/[^\p{L}\p{N}._-]+/gu, "_").replace(/^[_.]+|_+$/g, "").slice(0, 120);

/** Offer `blob` as the file `name`. */
export function save(name, blob) {
  const address = URL.createObjectURL(blob);
  const link = document.createElement("a");
  link.href = address;
  link.download = name;
  document.body.append(link);
  link.click();
  link.remove();
  // The browser reads the blob after the click was handled, so it is released later.
  setTimeout(() => URL.revokeObjectURL(address), 30000);
}

const cell = (value) => {
  const text = value === null || value === undefined ? "" : String(value);
  return /[",\n\r]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text;
};

/** Rows (arrays of cells) as CSV after RFC 4180; a missing number is an empty cell. */
export function saveCsv(name, rows) {
  const text = rows.map((row) => row.map(cell).join(",")).join("\r\n");
  save(`${fileName(name)}.csv`, new Blob([text, "\r\n"], { type: "text/csv;charset=utf-8" }));
}

/** SVG text as a file. */
export const saveSvg = (name, text) => save(`${fileName(name)}.svg`, new Blob([text], { type: "image/svg+xml" }));

/** SVG text as pixels, at twice the resolution of the screen; `size` is [width, height] in CSS pixels. */
export async function savePng(name, text, [width, height]) {
  const image = new Image(width, height);
  image.src = `data:image/svg+xml;charset=utf-8,${encodeURIComponent(text)}`;
  await image.decode();
  const canvas = document.createElement("canvas");
  [canvas.width, canvas.height] = [2 * width, 2 * height];
  canvas.getContext("2d").drawImage(image, 0, 0, canvas.width, canvas.height);
  const blob = await new Promise((resolve) => canvas.toBlob(resolve, "image/png"));
  save(`${fileName(name)}.png`, blob);
}
