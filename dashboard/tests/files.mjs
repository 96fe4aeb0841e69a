/** Files for tests: NIfTI volumes, TIFF stacks, and PLY meshes as they are read. */

/** A NIfTI-1 volume of bytes, to the right, front and head of a patient, with `value(i, j, k)` in its cells. */
export function nifti([nx, ny, nz], spacing, value) {
  const bytes = Buffer.alloc(352 + nx * ny * nz);
  bytes.writeInt32LE(348, 0);
  [3, nx, ny, nz, 1, 1, 1, 1].forEach((size, at) => bytes.writeInt16LE(size, 40 + 2 * at));
  bytes.writeInt16LE(2, 70);
  bytes.writeInt16LE(8, 72);
  [1, ...spacing, 1, 1, 1, 1].forEach((length, at) => bytes.writeFloatLE(length, 76 + 4 * at));
  bytes.writeFloatLE(352, 108);
  bytes.writeFloatLE(1, 112);
  bytes.writeUInt8(2, 123);
  bytes.writeInt16LE(1, 254);
  spacing.forEach((length, at) => bytes.writeFloatLE(length, 280 + 16 * at + 4 * at));
  bytes.write("n+1\0", 344, "latin1");
  for (let k = 0; k < nz; k++)
    for (let j = 0; j < ny; j++) for (let i = 0; i < nx; i++) bytes[352 + (k * ny + j) * nx + i] = value(i, j, k);
  return bytes;
}

/** A TIFF of pages of 16-bit greys, uncompressed, with `value(x, y, page)`. */
export function tiff(width, height, pages, value) {
  const parts = [Buffer.from("II*\0", "latin1"), Buffer.alloc(4)];
  let end = 8,
    link = parts[1],
    at = 0;
  const push = (part) => {
    parts.push(part);
    end += part.length;
  };
  for (let page = 0; page < pages; page++) {
    const data = Buffer.alloc(2 * width * height);
    for (let y = 0; y < height; y++)
      for (let x = 0; x < width; x++) data.writeUInt16LE(value(x, y, page), 2 * (y * width + x));
    const start = end;
    push(data);
    const tags = [
      [256, 4, width],
      [257, 4, height],
      [258, 3, 16],
      [259, 3, 1],
      [262, 3, 1],
      [273, 4, start],
      [277, 3, 1],
      [278, 4, height],
      [279, 4, data.length],
    ];
    const directory = Buffer.alloc(2 + 12 * tags.length + 4);
    directory.writeUInt16LE(tags.length, 0);
    tags.forEach(([tag, type, number], row) => {
      const from = 2 + 12 * row;
      directory.writeUInt16LE(tag, from);
      directory.writeUInt16LE(type, from + 2);
      directory.writeUInt32LE(1, from + 4);
      if (type === 3) directory.writeUInt16LE(number, from + 8);
      else directory.writeUInt32LE(number, from + 8);
    });
    link.writeUInt32LE(end, at);
    push(directory);
    [link, at] = [directory, directory.length - 4];
  }
  return Buffer.concat(parts);
}

/** Vertices and faces of a binary PLY with single numbers and triangles. */
export function ply(bytes) {
  const head = bytes.subarray(0, bytes.indexOf("end_header\n") + 11).toString("latin1");
  const count = (name) => Number(new RegExp(`element ${name} (\\d+)`).exec(head)[1]);
  let at = head.length;
  const vertices = Array.from({ length: count("vertex") }, () => {
    const point = [0, 4, 8].map((step) => bytes.readFloatLE(at + step));
    at += 12;
    return point;
  });
  const faces = Array.from({ length: count("face") }, () => {
    const face = [1, 5, 9].map((step) => bytes.readInt32LE(at + step));
    at += 13;
    return face;
  });
  return { vertices, faces };
}
