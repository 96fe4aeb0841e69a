/** Pictures, TIFF and NIfTI as grey volumes, their slices for the eye, and slices as files for the service. */

export type Values =
  | Uint8Array
  | Int8Array
  | Uint16Array
  | Int16Array
  | Int32Array
  | Uint32Array
  | Float32Array
  | Float64Array;

/** Cells of an image, x fastest. A picture in the plane has one slice along z. */
export interface Volume {
  name: string;
  size: [number, number, number];
  /** Distance of neighbouring cells along each axis: millimetres if `hasLengths`, else 1. */
  spacing: [number, number, number];
  hasLengths: boolean;
  /** For every axis of the cells, the axis of the patient (0: to the right, 1: to the front, 2: to the head) and its direction. */
  anatomy?: [Direction, Direction, Direction];
  values: Values;
  /** Values that are shown black and white. */
  range: [number, number];
  /** The picture in its colours. */
  colours?: Blob;
}
type Direction = { axis: number; sign: 1 | -1 };

/** What the service takes at most. */
const MOST_CELLS = 1 << 27;
const SUFFIX = /(\.nii)?(\.gz)?$|\.[^.]*$/i;
/** What the page reads itself, because it shows the cells and sends the slice that is shown; the service reads files of shapes. */
export const IMAGE_FORMATS = "PNG, JPEG, WebP, TIFF, NIfTI";
export const ACCEPT_IMAGES = ".png,.jpg,.jpeg,.webp,.tif,.tiff,.nii,.gz";
export const isPicture = (name: string): boolean => /\.(png|jpe?g|webp|tiff?|nii|nii\.gz)$/i.test(name);
const bare = (name: string): string => name.replace(/\.nii(\.gz)?$/i, "").replace(SUFFIX, "");

export async function volumeOf(file: File): Promise<Volume> {
  const volume = await (/\.nii(\.gz)?$/i.test(file.name)
    ? ofNifti(file)
    : /\.tiff?$/i.test(file.name)
      ? ofTiff(file)
      : ((await ofDeepPng(file)) ?? ofPicture(file)));
  return { ...volume, name: bare(file.name), range: rangeOf(volume.values) };
}

type Cells = Omit<Volume, "name" | "range">;

function checked(size: number[]): [number, number, number] {
  const [x, y, z] = size as [number, number, number];
  if (!(x > 0 && y > 0 && z > 0) || x * y * z > MOST_CELLS) throw new RangeError(`${x} × ${y} × ${z}`);
  return [x, y, z];
}

/** Luma of ITU-R BT.709, as the service reads colours. */
function luma(data: ArrayLike<number>, cells: number, channels: number, into: Values): Values {
  for (let k = 0; k < cells; k++)
    into[k] = 0.2126 * data[channels * k]! + 0.7152 * data[channels * k + 1]! + 0.0722 * data[channels * k + 2]!;
  return into;
}

async function ofPicture(file: File): Promise<Cells> {
  const bitmap = await createImageBitmap(file);
  const { width, height } = bitmap;
  const size = checked([width, height, 1]);
  const context = new OffscreenCanvas(width, height).getContext("2d", { willReadFrequently: true })!;
  context.drawImage(bitmap, 0, 0);
  const { data } = context.getImageData(0, 0, width, height);
  return {
    size,
    spacing: [1, 1, 1],
    hasLengths: false,
    values: luma(data, width * height, 4, new Uint8Array(width * height)),
    colours: file,
  };
}

const inflated = (data: BlobPart[], format: CompressionFormat): Promise<ArrayBuffer> =>
  new Response(new Blob(data).stream().pipeThrough(new DecompressionStream(format))).arrayBuffer();

/**
 * A PNG of 16 bits, of which browsers keep eight: labels beyond those would vanish. Null for all others, and for interlaced ones.
 */
async function ofDeepPng(file: File): Promise<Cells | null> {
  const bytes = new Uint8Array(await file.arrayBuffer()),
    view = new DataView(bytes.buffer);
  if (bytes.length < 33 || view.getUint32(0) !== 0x89504e47 || bytes[24] !== 16 || bytes[28] !== 0) return null;
  const size = checked([view.getUint32(16), view.getUint32(20), 1]),
    [width, height] = size;
  const channels = ({ 0: 1, 2: 3, 4: 2, 6: 4 } as Record<number, number>)[bytes[25]!]!,
    pixel = 2 * channels,
    row = width * pixel;
  const parts: BlobPart[] = [];
  for (let at = 8; at + 12 <= bytes.length; at += 12 + view.getUint32(at)) {
    if (view.getUint32(at + 4) === 0x49444154) parts.push(bytes.subarray(at + 8, at + 8 + view.getUint32(at)));
  }
  const lines = new Uint8Array(await inflated(parts, "deflate"));
  const data = new Uint16Array(width * height * channels);
  let before = new Uint8Array(row);
  for (let y = 0; y < height; y++) {
    const filter = lines[y * (row + 1)]!,
      line = lines.subarray(y * (row + 1) + 1, (y + 1) * (row + 1));
    for (let x = 0; x < row; x++) {
      const a = x >= pixel ? line[x - pixel]! : 0,
        b = before[x]!,
        c = x >= pixel ? before[x - pixel]! : 0;
      line[x]! += filter === 1 ? a : filter === 2 ? b : filter === 3 ? (a + b) >> 1 : filter === 4 ? paeth(a, b, c) : 0;
    }
    for (let k = 0; k < width * channels; k++) data[y * width * channels + k] = line[2 * k]! * 256 + line[2 * k + 1]!;
    before = line;
  }
  const values = new Uint16Array(width * height);
  if (channels >= 3) luma(data, width * height, channels, values);
  else for (let k = 0; k < values.length; k++) values[k] = data[channels * k]!;
  return { size, spacing: [1, 1, 1], hasLengths: false, values };
}

/** Which of the left, upper and upper left byte is nearest to left + upper − upper left. */
function paeth(a: number, b: number, c: number): number {
  const [da, db, dc] = [Math.abs(b - c), Math.abs(a - c), Math.abs(a + b - 2 * c)];
  return da <= db && da <= dc ? a : db <= dc ? b : c;
}

async function ofTiff(file: File): Promise<Cells> {
  const { decode } = await import("tiff");
  const pages = decode(await file.arrayBuffer()).filter((page) => page.data.length > 0);
  const first = pages[0]!;
  const { width, height, data } = first;
  const size = checked([width, height, pages.length]);
  const cells = width * height;
  const values = new (data.constructor as { new (length: number): Values })(cells * pages.length);
  for (const [at, page] of pages.entries()) {
    if (page.width !== width || page.height !== height) throw new RangeError(`${page.width} × ${page.height}`);
    const into = values.subarray(at * cells, (at + 1) * cells) as Values;
    const channels = page.data.length / cells;
    if (channels >= 3) luma(page.data, cells, channels, into);
    else for (let k = 0; k < cells; k++) into[k] = page.data[channels * k]!;
    // White is zero.
    if (page.type === 0) {
      const most = 2 ** page.bitsPerSample - 1;
      for (let k = 0; k < cells; k++) into[k] = most - into[k]!;
    }
  }
  return { size, spacing: [1, 1, 1], hasLengths: false, values };
}

/** Types of NIfTI-1 by their codes. */
const TYPES: Record<number, { new (buffer: ArrayBuffer): Values; BYTES_PER_ELEMENT: number }> = {
  2: Uint8Array,
  4: Int16Array,
  8: Int32Array,
  16: Float32Array,
  64: Float64Array,
  256: Int8Array,
  512: Uint16Array,
  768: Uint32Array,
};

async function ofNifti(file: File): Promise<Cells> {
  let buffer = await file.arrayBuffer();
  if (new Uint8Array(buffer, 0, 2).join() === "31,139") buffer = await inflated([buffer], "gzip");
  const head = new DataView(buffer);
  const little = head.getInt32(0, true) === 348;
  if (!little && head.getInt32(0) !== 348) throw new TypeError("NIfTI-1");
  const short = (at: number) => head.getInt16(at, little),
    real = (at: number) => head.getFloat32(at, little);
  const axes = short(40);
  const size = checked([1, 2, 3].map((axis) => (axis <= axes ? short(40 + 2 * axis) : 1)));
  const type = TYPES[short(70)];
  if (!type) throw new TypeError(`NIfTI-1 ${short(70)}`);
  const cells = size[0] * size[1] * size[2],
    bytes = cells * type.BYTES_PER_ELEMENT,
    from = real(108);
  const data = buffer.slice(from, from + bytes);
  if (data.byteLength < bytes) throw new RangeError("NIfTI-1");
  if (!little && type.BYTES_PER_ELEMENT > 1)
    new Uint8Array(data).forEach((_, at, all) => {
      if (at % type.BYTES_PER_ELEMENT === 0) all.subarray(at, at + type.BYTES_PER_ELEMENT).reverse();
    });
  let values: Values = new type(data);
  const slope = real(112),
    inter = real(116);
  if (Number.isFinite(slope) && slope !== 0 && (slope !== 1 || inter !== 0))
    values = Float32Array.from(values as Float32Array, (value) => slope * value + inter);
  const unit = head.getUint8(123) & 7,
    factor = { 1: 1000, 3: 0.001 }[unit] ?? 1;
  const spacing = [1, 2, 3].map((axis) =>
    axis <= axes && Math.abs(real(76 + 4 * axis)) > 0 ? Math.abs(real(76 + 4 * axis)) * factor : 1,
  ) as Volume["spacing"];
  return {
    size,
    spacing,
    hasLengths: unit > 0 || short(252) > 0 || short(254) > 0,
    anatomy: anatomyOf(short, real),
    values,
  };
}

/** Directions of the axes of the cells in the patient: of the `sform`, else of the `qform`. */
function anatomyOf(short: (at: number) => number, real: (at: number) => number): Volume["anatomy"] {
  let rows: number[][];
  if (short(254) > 0) rows = [280, 296, 312].map((at) => [0, 4, 8].map((step) => real(at + step)));
  else if (short(252) > 0) {
    const [b, c, d] = [256, 260, 264].map(real) as [number, number, number],
      a = Math.sqrt(Math.max(1 - b * b - c * c - d * d, 0)),
      q = real(76) < 0 ? -1 : 1;
    rows = [
      [a * a + b * b - c * c - d * d, 2 * (b * c - a * d), 2 * q * (b * d + a * c)],
      [2 * (b * c + a * d), a * a + c * c - b * b - d * d, 2 * q * (c * d - a * b)],
      [2 * (b * d - a * c), 2 * (c * d + a * b), q * (a * a + d * d - b * b - c * c)],
    ];
  } else return undefined;
  const found = [0, 1, 2].map((column): Direction => {
    const axis = [0, 1, 2].reduce(
      (best, row) => (Math.abs(rows[row]![column]!) > Math.abs(rows[best]![column]!) ? row : best),
      0,
    );
    return { axis, sign: rows[axis]![column]! < 0 ? -1 : 1 };
  });
  return new Set(found.map((one) => one.axis)).size === 3 ? (found as Volume["anatomy"]) : undefined;
}

/** Percentiles ½ and 99½, of at most some hundred thousand values. */
function rangeOf(values: Values): [number, number] {
  const step = Math.max(1, Math.floor(values.length / 200_000));
  const some = Float64Array.from({ length: Math.ceil(values.length / step) }, (_, k) => values[k * step]!)
    .filter(Number.isFinite)
    .sort();
  const at = (part: number) => some[Math.round(part * (some.length - 1))] ?? 0;
  const [low, high] = [at(0.005), at(0.995)];
  return high > low ? [low, high] : [some[0] ?? 0, Math.max(some[some.length - 1] ?? 1, (some[0] ?? 0) + 1)];
}

/** Planes across the axes of the patient, else of the cells: named by the axis that they cut. */
export type Plane = 0 | 1 | 2;

/** One slice, as it lies on the screen. */
export interface Slice {
  size: [number, number];
  spacing: [number, number];
  values: Values;
  /** Letters of the patient at the left, right, upper and lower side. */
  sides?: [string, string, string, string];
}

const LETTERS = [
  ["L", "R"],
  ["P", "A"],
  ["I", "S"],
] as const;

/** Which axis of the cells a plane cuts, and which run along the screen, with their directions. */
export function layout(
  { anatomy }: Volume,
  plane: Plane,
): { cut: number; across: number; down: number; flips: [boolean, boolean]; sides?: Slice["sides"] } {
  const others = ([0, 1, 2] as const).filter((axis) => axis !== plane) as [number, number];
  if (!anatomy) return { cut: plane, across: others[0], down: others[1], flips: [false, false] };
  const of = (axis: number) => anatomy.findIndex((one) => one.axis === axis);
  // As radiologists look at them: the patient's right at the left side, the front at the left or on top, the head on top.
  const [across, down] = others.map(of) as [number, number];
  const flips = [anatomy[across]!.sign > 0, anatomy[down]!.sign > 0] as [boolean, boolean];
  const sides = [
    LETTERS[others[0]]![1],
    LETTERS[others[0]]![0],
    LETTERS[others[1]]![1],
    LETTERS[others[1]]![0],
  ] as Slice["sides"];
  return { cut: of(plane), across, down, flips, sides };
}

/** Number of slices of a plane. */
export const depthOf = (volume: Volume, plane: Plane): number => volume.size[layout(volume, plane).cut]!;

export function sliceOf(volume: Volume, plane: Plane, index: number): Slice {
  const { cut, across, down, flips, sides } = layout(volume, plane);
  const strides = [1, volume.size[0], volume.size[0] * volume.size[1]];
  const [width, height] = [volume.size[across]!, volume.size[down]!];
  const values = new (volume.values.constructor as { new (length: number): Values })(width * height);
  for (let row = 0; row < height; row++) {
    const start = index * strides[cut]! + (flips[1] ? height - 1 - row : row) * strides[down]!;
    for (let column = 0; column < width; column++)
      values[row * width + column] =
        volume.values[start + (flips[0] ? width - 1 - column : column) * strides[across]!]!;
  }
  return { size: [width, height], spacing: [volume.spacing[across]!, volume.spacing[down]!], values, sides };
}

/** The slice in grey, for the eye: from the value that is black to the one that is white. Pictures keep their colours otherwise. */
export async function shownOf(volume: Volume, slice: Slice, range?: [number, number]): Promise<Blob> {
  if (volume.colours && !range) return volume.colours;
  const [low, high] = range ?? volume.range,
    [width, height] = slice.size;
  const image = new ImageData(width, height);
  for (let k = 0; k < slice.values.length; k++) {
    image.data.fill((255 * (slice.values[k]! - low)) / (high - low), 4 * k, 4 * k + 3);
    image.data[4 * k + 3] = 255;
  }
  const canvas = new OffscreenCanvas(width, height);
  canvas.getContext("2d")!.putImageData(image, 0, 0);
  return canvas.convertToBlob({ type: "image/png" });
}

/** The slice as a file for the service (NIfTI-1): its values as they are, rows downwards, lengths in millimetres where they are known. */
export function fileOf({ hasLengths }: Volume, slice: Slice): Blob {
  const head = new DataView(new ArrayBuffer(352));
  const code = Number(Object.entries(TYPES).find(([, type]) => slice.values instanceof type)![0]);
  head.setInt32(0, 348, true);
  [2, ...slice.size, 1, 1, 1, 1, 1].forEach((value, at) => head.setInt16(40 + 2 * at, value, true));
  head.setInt16(70, code, true);
  head.setInt16(72, 8 * slice.values.BYTES_PER_ELEMENT, true);
  [1, ...slice.spacing, 1, 1, 1, 1, 1].forEach((value, at) => head.setFloat32(76 + 4 * at, value, true));
  head.setFloat32(108, 352, true);
  head.setFloat32(112, 1, true);
  head.setUint8(123, hasLengths ? 2 : 0);
  [110, 43, 49, 0].forEach((value, at) => head.setUint8(344 + at, value));
  return new Blob([head.buffer, slice.values as BlobPart]);
}
