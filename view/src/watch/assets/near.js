// Who is near an agent or a station, in words.

/** @import { Neighbour, Neighbourhood, PairLine, RemoteMap } from "./types.js" */

/** @param {number} bytes */
const kilobytes = (bytes) => `${Math.round(bytes / 1e3).toLocaleString("en")} kB`;

/** @param {number} seconds */
const lasting = (seconds) => (seconds < 120 ? `${Math.round(seconds)} s` : seconds < 7200 ? `${Math.round(seconds / 60)} min` : `${Math.round(seconds / 3600)} h`);

/** @param {Neighbour} link */
function neighbour({ name, address, since_s, why, received, wanted, rate, lacks }) {
  if (why !== null) return { kind: "trouble", text: `${name}: does not answer for ${lasting(since_s)}: ${why}` };
  const parts = [address === null ? `not there for ${lasting(since_s)}` : address];
  if (received > 0) parts.push(`sent ${kilobytes(received)}`);
  if (wanted > 0) parts.push(`is asked for ${wanted} objects at ${kilobytes(rate)}/s`);
  if (lacks === 0) parts.push("holds all of this map");
  else if (lacks !== null) parts.push(`lacks ${lacks} objects of this map`);
  return { kind: address === null ? "gone" : "there", text: `${name}: ${parts.join(", ")}` };
}

/** @param {RemoteMap} map */
function told({ name, keyframes, missing, finished, is_lidar, is_joined }) {
  const parts = [`${keyframes} keyframes${is_lidar ? " of a LiDAR" : ""}`, missing === 0 ? "all here" : `${missing} objects missing`];
  parts.push(finished ? "run over" : "under way");
  if (is_joined) parts.push("in the common map");
  return { kind: is_joined ? "joined" : "apart", text: `map of ${name}: ${parts.join(", ")}` };
}

/** @param {PairLine} meeting */
function meeting({ names, verdict, why, is_told }) {
  const said = is_told ? `${verdict}, as another found` : verdict;
  return { kind: verdict.replace(" ", "-"), text: `${names.join(" + ")}: ${said}${why === null ? "" : ` – ${why}`}` };
}

/**
 * Lines for people, the kind of each a word that colours it: neighbours first, then their maps, what became of meeting
 * and what was refused.
 * @param {Neighbourhood} near
 * @returns {{ kind: string, text: string }[]}
 */
export function nearLines({ listening, links, maps, meetings, trouble }) {
  const place = listening === null ? [] : [{ kind: "place", text: `reached at ${listening}` }];
  const nobody = links.length === 0 ? [{ kind: "gone", text: "nobody is near" }] : [];
  const refused = trouble.map((text) => ({ kind: "trouble", text }));
  return [...place, ...nobody, ...links.map(neighbour), ...maps.map(told), ...meetings.map(meeting), ...refused];
}
