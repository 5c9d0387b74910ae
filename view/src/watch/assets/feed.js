// The WebSocket: what comes over it, and the commands that go back.

import { decode } from "./decode.js";

export class Feed {
  /**
   * `on` is called with the kind of what came and what it says: `link` (whether the program answers), the kinds of binary
   * messages (`decode.js`) and those of texts.
   * @param {(kind: string, value: any) => void} on
   */
  constructor(on) {
    this.on = on;
    // The browser has kept the token as a cookie: neither a screen that is shared nor the history need show it.
    if (location.search && navigator.cookieEnabled) history.replaceState(null, "", location.pathname);
    this.connect();
  }

  connect() {
    this.socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/ws${location.search}`);
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
    if (message.kind === "round") this.socket.send(JSON.stringify({ answer: message.round }));
    else this.on(message.kind, message);
  }

  takeWords(buffer) {
    const told = decode(buffer);
    if (told) this.on(told.kind, told.value);
  }
}
