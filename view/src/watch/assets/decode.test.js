import assert from "node:assert/strict";
import test from "node:test";
import { decode } from "./decode.js";

/** A message by its parts: whole numbers as words, `{ f: x }` as floats, `{ d: x }` as doubles, arrays as bytes. */
function message(...parts) {
  const bytes = [];
  const put = (size, write) => {
    const view = new DataView(new ArrayBuffer(size));
    write(view);
    bytes.push(...new Uint8Array(view.buffer));
  };
  for (const part of parts) {
    if (Array.isArray(part)) bytes.push(...part);
    else if (typeof part === "number") put(4, (view) => view.setUint32(0, part, true));
    else if ("f" in part) put(4, (view) => view.setFloat32(0, part.f, true));
    else put(8, (view) => view.setFloat64(0, part.d, true));
  }
  return Uint8Array.from(bytes).buffer;
}
const floats = (...values) => values.map((f) => ({ f }));

test("keyframes come with their poses", () => {
  const pose = Array.from({ length: 12 }, (_, i) => i + 0.5);
  const { kind, value } = decode(message(1, 2, 7, 0, 70, { f: 1.5 }, ...floats(...pose), 8, 1, 80, { f: 2 }, ...floats(...pose.map((v) => -v))));
  assert.equal(kind, "keyframes");
  assert.deepEqual(value.map(({ id, agent, frame, scale }) => [id, agent, frame, scale]), [[7, 0, 70, 1.5], [8, 1, 80, 2]]);
  assert.deepEqual(Array.from(value[0].pose), pose);
  assert.equal(value[1].pose[11], -11.5);
});

test("steps of the trajectory keep seconds that floats could not hold", () => {
  const seconds = 1700000000.066667;
  const { kind, value } = decode(message(2, 5, 2, 0, 9, { d: seconds }, ...floats(1, 2, 3, 0, 0, 0, 1), 1, 10, { d: seconds + 0.1 }, ...floats(4, 5, 6, 0, 0.5, 0, 0.5)));
  assert.equal(kind, "trajectory");
  assert.deepEqual([value.from, value.count, Array.from(value.agent), Array.from(value.frame)], [5, 2, [0, 1], [9, 10]]);
  assert.deepEqual(Array.from(value.timestamp), [seconds, seconds + 0.1]);
  assert.deepEqual(Array.from(value.position), [1, 2, 3, 4, 5, 6]);
  assert.deepEqual(Array.from(value.rotation.slice(4)), [0, 0.5, 0, 0.5]);
});

test("a chunk's points are seen as words and as bytes", () => {
  const point = [0xff, 0xff, 0, 0x80, 1, 0, 200, 40];
  const { kind, value } = decode(message(3, 12, 1, 1, 640, 480, ...floats(500, 501, 319.5, 239.5, 0.125, 2), point));
  assert.equal(kind, "chunk");
  assert.deepEqual([value.id, value.agent, value.count], [12, 1, 1]);
  assert.deepEqual(value.camera, { width: 640, height: 480, fx: 500, fy: 501, cx: 319.5, cy: 239.5 });
  assert.deepEqual([...value.depth, ...value.words.slice(0, 3), value.bytes[6], value.bytes[7]], [0.125, 2, 65535, 0x8000, 1, 200, 40]);
  assert.equal(value.colours, null);
  const coloured = decode(message(3, 12, 1, 1, 640, 480, ...floats(500, 501, 319.5, 239.5, 0.125, 2), [...point, 10, 20, 30]));
  assert.deepEqual([...coloured.value.colours], [10, 20, 30]);
});

test("a picture has its depths over it", () => {
  const { kind, value } = decode(message(4, 33, 3, 2, 1, ...floats(0.1, 0.9), [2, 0, 1, 0], [77], [1, 2, 3, 4, 5, 6]));
  assert.equal(kind, "picture");
  assert.deepEqual([value.frame, value.width, value.height, value.count], [33, 3, 2, 1]);
  assert.deepEqual([...value.pixels, ...value.codes, ...value.grey], [2, 1, 77, 1, 2, 3, 4, 5, 6]);
});

test("edges are three words each", () => {
  assert.deepEqual([...decode(message(5, 2, 1, 0, 2, 3, 1, 3)).value], [1, 0, 2, 3, 1, 3]);
});

test("what is cut short or unknown is nothing", () => {
  const whole = [message(1, 1, 7, 0, 70, ...floats(...Array(13).fill(1))), message(2, 0, 1, 0, 9, { d: 1 }, ...floats(1, 2, 3, 0, 0, 0, 1)),
    message(3, 1, 0, 2, 64, 48, ...floats(1, 1, 1, 1, 1, 1), Array(16).fill(0)), message(4, 1, 4, 4, 0, ...floats(0, 1), Array(16).fill(0)), message(5, 1, 0, 1, 2)];
  for (const buffer of whole) {
    assert.ok(decode(buffer));
    for (let length = 0; length < buffer.byteLength; length += 4) assert.equal(decode(buffer.slice(0, length)), null);
  }
  for (const kind of [0, 6, 4294967295]) assert.equal(decode(message(kind, 0, 0)), null);
  // More than memory holds.
  assert.equal(decode(message(1, 4294967295)), null);
});
