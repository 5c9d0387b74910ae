// What comes over the WebSocket, as `web/encode.rs` writes it, and the commands that go back.

class Feed {
  /** `on` is called with `reset`, `level`, `status`, `keyframes`, `trajectory`, `chunk`, `picture`, `edges`, `link`. */
  constructor(on) {
    this.on = on;
    this.connect();
  }

  connect() {
    this.socket = new WebSocket(`ws://${location.host}/ws${location.search}`);
    this.socket.binaryType = "arraybuffer";
    this.socket.onopen = () => this.on("link", true);
    this.socket.onmessage = ({ data: message }) => (typeof message === "string" ? this.takeText(JSON.parse(message)) : this.takeWords(message));
    this.socket.onclose = () => {
      this.on("link", false);
      setTimeout(() => this.connect(), 1500);
    };
  }

  /** Sends a command to the run. */
  command(name, on) {
    if (this.socket.readyState !== WebSocket.OPEN) return;
    this.socket.send(JSON.stringify(on === undefined ? { command: name } : { command: name, on }));
  }

  takeText(message) {
    // The server waits for this before it sends more: a page that is busy drawing must not fall behind.
    if (message.kind === "round") return this.socket.send(JSON.stringify({ answer: message.round }));
    if (message.kind === "reset") forget();
    if (message.kind === "level") Object.assign(data.scene, { up: message.up, forward: message.forward });
    return this.on(message.kind, message);
  }

  takeWords(buffer) {
    const words = new Uint32Array(buffer, 0, buffer.byteLength >> 2), floats = new Float32Array(buffer, 0, buffer.byteLength >> 2);
    const kind = [null, "keyframes", "trajectory", "chunk", "picture", "edges"][words[0]];
    if (kind) this.on(kind, this[kind](buffer, words, floats));
  }

  keyframes(buffer, words, floats) {
    const slots = [];
    for (let i = 0, at = 2; i < words[1]; i++, at += 16) {
      slots.push(place(words[at], words[at + 1], words[at + 2], floats[at + 3], floats.subarray(at + 4, at + 16)));
    }
    return slots;
  }

  trajectory(buffer, words, floats) {
    const [from, count] = [words[1], words[2]];
    trajectory.count = from + count;
    trajectory.position = grown(trajectory.position, trajectory.count * 3);
    trajectory.frame = grown(trajectory.frame, trajectory.count);
    store.stepAgent = grown(store.stepAgent, trajectory.count);
    for (let i = 0, at = 3; i < count; i++, at += 5) {
      store.stepAgent[from + i] = words[at];
      trajectory.frame[from + i] = words[at + 1];
      trajectory.position.set(floats.subarray(at + 2, at + 5), (from + i) * 3);
    }
    return from;
  }

  chunk(buffer, words, floats) {
    const [, id, agent, count, width, height] = words;
    const [fx, fy, cx, cy, low, high] = floats.subarray(6, 12);
    const chunk = {
      id, agent, count, slot: store.slots.get(id), camera: { width, height, fx, fy, cx, cy }, depth: [low, high],
      bytes: new Uint8Array(buffer, 48, count * 8), words: new Uint16Array(buffer, 48, count * 4), matrix: null,
    };
    if (chunk.slot !== undefined) setChunk(id, chunk);
    return chunk;
  }

  picture(buffer, words, floats) {
    const [, frame, width, height, count] = words;
    return {
      frame, width, height, count, range: [floats[5], floats[6]],
      pixels: new Uint16Array(buffer, 28, count * 2), codes: new Uint8Array(buffer, 28 + count * 4, count),
      grey: new Uint8Array(buffer, 28 + count * 5, width * height),
    };
  }

  edges(buffer, words) {
    store.edges = words.slice(2, 2 + words[1] * 3);
  }
}
