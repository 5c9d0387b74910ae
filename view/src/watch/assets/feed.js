// The WebSocket: what comes over it, and the commands that go back.

import { decode } from "./decode.js";
/** @import { Handlers } from "./types.js" */

export class Feed {
  /**
   * Of `handlers` the one that is named as what came is told what it says: `link` (whether the program answers), the kinds of
   * binary messages (`decode.js`) and those of texts.
   * @param {Handlers} handlers
   */
  constructor(handlers) {
    this.handlers = handlers;
    // The browser has kept the token as a cookie: neither a screen that is shared nor the history need show it.
    if (location.search && navigator.cookieEnabled) history.replaceState(null, "", location.pathname);
    this.socket = this.connect();
  }

  /** A socket that is replaced once it is closed. */
  connect() {
    const socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/ws${location.search}`);
    socket.binaryType = "arraybuffer";
    socket.onopen = () => this.take("link", true);
    socket.onmessage = ({ data: message }) => (typeof message === "string" ? this.takeText(JSON.parse(message)) : this.takeWords(message));
    socket.onclose = () => {
      this.take("link", false);
      setTimeout(() => (this.socket = this.connect()), 1500);
    };
    return socket;
  }

  /** Sends a command to the run. @param {string} name @param {boolean} [on] */
  command(name, on) {
    if (this.socket.readyState !== WebSocket.OPEN) return;
    this.socket.send(JSON.stringify(on === undefined ? { command: name } : { command: name, on }));
  }

  /** Hands on what came. @param {string} kind @param {any} value */
  take(kind, value) {
    const handler = this.handlers[kind];
    if (handler) handler(value);
  }

  /** @param {any} message a text's JSON */
  takeText(message) {
    // The server waits for this before it sends more: a page that is busy drawing must not fall behind.
    if (message.kind === "round") this.socket.send(JSON.stringify({ answer: message.round }));
    else this.take(message.kind, message);
  }

  /** @param {ArrayBuffer} buffer */
  takeWords(buffer) {
    const told = decode(buffer);
    if (told) this.take(told.kind, told.value);
  }
}
