// What is shown, as files of other tools.

/**
 * A cloud as binary PLY: of each point x, y, z and red, green, blue.
 * @param {number[][]} places @param {ArrayLike<number>[]} colours @param {string} comment
 */
export function plyFile(places, colours, comment) {
  const properties = ["float x", "float y", "float z", "uchar red", "uchar green", "uchar blue"];
  const lines = ["ply", "format binary_little_endian 1.0", `comment ${comment}`, `element vertex ${places.length}`];
  const head = new TextEncoder().encode([...lines, ...properties.map((p) => `property ${p}`), "end_header", ""].join("\n"));
  const bytes = new Uint8Array(head.length + places.length * 15), view = new DataView(bytes.buffer);
  bytes.set(head);
  places.forEach((p, i) => {
    const at = head.length + i * 15;
    p.forEach((v, axis) => view.setFloat32(at + axis * 4, v, true));
    bytes.set(colours[i], at + 12);
  });
  return bytes;
}

/**
 * The frames from `first` to before `end` as TUM text: time stamp, centre and rotation of the camera in the world.
 * @param {{ timestamp: ArrayLike<number>, position: ArrayLike<number>, rotation: ArrayLike<number> }} trajectory
 * @param {number} first @param {number} end
 */
export function tumFile({ timestamp, position, rotation }, first, end) {
  /** @param {ArrayLike<number>} values @param {number} size @param {number} i */
  const part = (values, size, i) => Array.from({ length: size }, (_, k) => String(Number(Number(values[i * size + k]).toPrecision(7))));
  let text = "# timestamp tx ty tz qx qy qz qw\n";
  for (let i = first; i < end; i++) text += `${[timestamp[i].toFixed(9), ...part(position, 3, i), ...part(rotation, 4, i)].join(" ")}\n`;
  return text;
}
