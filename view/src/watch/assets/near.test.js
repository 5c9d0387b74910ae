import assert from "node:assert/strict";
import test from "node:test";
import { nearLines } from "./near.js";

const link = { name: "car-7", address: "10.0.0.7:7447", since_s: 9, why: null, received: 1234567, wanted: 3, rate: 32000, lacks: 5 };

test("a neighbour, a refusal and its reason are said", () => {
  const meetings = [
    { names: ["a", "b"], verdict: "accepted", why: null, is_told: false },
    { names: ["a", "c"], verdict: "refused", why: "too few points agree", is_told: true },
    { names: ["b", "c"], verdict: "not yet", why: "3 matches are too few", is_told: false },
  ];
  const maps = [
    { name: "a", keyframes: 31, missing: 0, finished: true, is_lidar: false, is_joined: true },
    { name: "c", keyframes: 9, missing: 12, finished: false, is_lidar: true, is_joined: false },
  ];
  const lines = nearLines({ listening: "tls/0.0.0.0:7447", links: [link], maps, meetings, trouble: ["x is refused: its certificate has expired"] });
  assert.deepEqual(lines, [
    { kind: "place", text: "reached at tls/0.0.0.0:7447" },
    { kind: "there", text: "car-7: 10.0.0.7:7447, sent 1,235 kB, is asked for 3 objects at 32 kB/s, lacks 5 objects of this map" },
    { kind: "joined", text: "map of a: 31 keyframes, all here, run over, in the common map" },
    { kind: "apart", text: "map of c: 9 keyframes of a LiDAR, 12 objects missing, under way" },
    { kind: "accepted", text: "a + b: accepted" },
    { kind: "refused", text: "a + c: refused, as another found – too few points agree" },
    { kind: "not-yet", text: "b + c: not yet – 3 matches are too few" },
    { kind: "trouble", text: "x is refused: its certificate has expired" },
  ]);
});

test("who is gone is not there, and nobody is said too", () => {
  const gone = { ...link, address: null, since_s: 185, received: 0, wanted: 0, lacks: 0 };
  const lines = nearLines({ listening: null, links: [gone], maps: [], meetings: [], trouble: [] });
  assert.deepEqual(lines, [{ kind: "gone", text: "car-7: not there for 3 min, holds all of this map" }]);
  const silent = { ...gone, name: "tls/base:7447", since_s: 12.4, why: "Connection refused" };
  assert.deepEqual(nearLines({ listening: null, links: [silent], maps: [], meetings: [], trouble: [] }), [
    { kind: "trouble", text: "tls/base:7447: does not answer for 12 s: Connection refused" },
  ]);
  assert.deepEqual(nearLines({ listening: null, links: [], maps: [], meetings: [], trouble: [] }), [{ kind: "gone", text: "nobody is near" }]);
});
