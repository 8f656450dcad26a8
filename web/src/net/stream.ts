/**
 * WebSocket connection to the server: encodes and decodes messages, reconnects after a loss and reports the connection
 * status.
 */

import { CLOSE_CODES, type ClientMessage, NO_COMMANDS, type ServerMessage, WIRE_VERSION } from "../wire/messages";
import { parsePicture, parseServerMessage, WireError, type WirePicture } from "../wire/parse";

/** Status of the connection to the server. */
export type StreamStatus =
  | { status: "connecting" }
  | { status: "open" }
  | { status: "lost"; retryAtMs: number; reason: string | null }
  /** The server refused the connection. The client does not reconnect, because only the user can resolve the reason. */
  | { status: "refused"; reason: string };

/** Callbacks of a {@link Stream}. */
export interface StreamHandlers {
  status(status: StreamStatus): void;
  message(message: ServerMessage): void;
  picture(picture: WirePicture): void;
  /** Report a message that violates the protocol; the stream discards the message. */
  fault(words: string): void;
}

/** The part of the browser's WebSocket interface that the stream uses; tests supply a fake. */
export interface Socket {
  binaryType: string;
  readonly readyState: number;
  onopen: ((event: never) => void) | null;
  onmessage: ((event: never) => void) | null;
  onclose: ((event: never) => void) | null;
  send(text: string): void;
  close(): void;
}

/** Clock and timer of a {@link Stream}; tests supply a fake. */
export interface StreamClock {
  nowMs(): number;
  /** Call `call` after `ms` milliseconds; return a function that cancels the call. */
  after(ms: number, call: () => void): () => void;
}

/** `WebSocket.OPEN`, the state of a socket that can send. */
const OPEN = 1;
/** Delay before the first retry, ms. */
const FIRST_RETRY_MS = 500;
/** Maximum delay before a retry, ms. */
const LAST_RETRY_MS = 8000;

/** Return the delay before the n-th retry (0 is the first) in ms; the delay doubles up to a maximum. */
export function retryDelayMs(attempt: number): number {
  return Math.min(FIRST_RETRY_MS * 2 ** Math.min(attempt, 10), LAST_RETRY_MS);
}

const NO_USE_TRYING = new Map<number, string>([
  [CLOSE_CODES["protocol.malformed"], "Carina could not read a message from this page. Reload the page."],
  [CLOSE_CODES["protocol.order"], "Carina could not read a message from this page. Reload the page."],
  [
    CLOSE_CODES["protocol.not-authorised"],
    "This page no longer has access to Carina. Open the address that Carina printed when it started.",
  ],
  [CLOSE_CODES["protocol.version"], "This page and Carina have different versions. Reload the page."],
  [
    CLOSE_CODES["protocol.too-many-windows"],
    "Carina is already open in the maximum number of windows. Close one of them, then connect again.",
  ],
  [CLOSE_CODES["protocol.watching-ended"], "The case that you were watching was closed."],
  [
    CLOSE_CODES["protocol.flood"],
    "This page sent too many messages. Ask the person at the workstation for a new link.",
  ],
]);

/** The client's connection to the server, which reconnects after a loss. */
export class Stream {
  readonly #connect: () => Socket;
  readonly #handlers: StreamHandlers;
  readonly #clock: StreamClock;
  #socket: Socket | null = null;
  #attempt = 0;
  #callOff: (() => void) | null = null;
  #ended = false;
  #numCommands = 0;
  readonly #token: string | null;

  /** `token` is the access token from a watcher's link; null for the user of the workstation. */
  constructor(connect: () => Socket, handlers: StreamHandlers, clock: StreamClock, token: string | null = null) {
    this.#token = token;
    this.#connect = connect;
    this.#handlers = handlers;
    this.#clock = clock;
  }

  /** Connect now, without waiting for the next retry; the "Try now" button calls this method. */
  open = (): void => {
    this.#callOff?.();
    this.#callOff = null;
    this.#ended = false;
    const previous = this.#socket;
    this.#socket = null;
    previous?.close();
    this.#handlers.status({ status: "connecting" });
    let socket: Socket;
    try {
      socket = this.#connect();
    } catch {
      this.#lost(null);
      return;
    }
    socket.binaryType = "arraybuffer";
    this.#socket = socket;
    this.#numCommands = 0;
    socket.onopen = () => {
      if (this.#socket !== socket) return;
      const token = this.#token === null ? {} : { token: this.#token };
      socket.send(JSON.stringify({ type: "hello", wire_version: WIRE_VERSION, ...token }));
    };
    socket.onmessage = (event: { data: unknown }) => {
      if (this.#socket === socket) this.#receive(event.data);
    };
    socket.onclose = (event: { code: number; reason: string }) => {
      if (this.#socket !== socket) return;
      this.#socket = null;
      if (this.#ended) return;
      const useless = NO_USE_TRYING.get(event.code);
      if (useless !== undefined) this.#handlers.status({ status: "refused", reason: event.reason || useless });
      else this.#lost(event.reason || null);
    };
  };

  /**
   * Send a message; return false without a connection. The message is not queued, because it would be outdated after
   * the reconnection.
   */
  send = (message: ClientMessage): boolean => {
    if (this.#socket === null || this.#socket.readyState !== OPEN) return false;
    this.#socket.send(JSON.stringify(message));
    if (!NO_COMMANDS.includes(message.type)) this.#numCommands += 1;
    return true;
  };

  /**
   * Number of commands that were sent on this connection; `handled` messages count how many of them the server has
   * executed.
   */
  get numCommands(): number {
    return this.#numCommands;
  }

  close = (): void => {
    this.#ended = true;
    this.#callOff?.();
    this.#socket?.close();
    this.#socket = null;
  };

  #lost(reason: string | null): void {
    const delayMs = retryDelayMs(this.#attempt);
    this.#attempt += 1;
    this.#handlers.status({ status: "lost", retryAtMs: this.#clock.nowMs() + delayMs, reason });
    this.#callOff = this.#clock.after(delayMs, this.open);
  }

  #receive(data: unknown): void {
    try {
      if (typeof data === "string") {
        const message = parseServerMessage(data);
        if (message.type === "hello") {
          this.#attempt = 0;
          this.#handlers.status({ status: "open" });
        }
        this.#handlers.message(message);
      } else if (data instanceof ArrayBuffer) {
        this.#handlers.picture(parsePicture(data));
      }
    } catch (error) {
      if (!(error instanceof WireError)) throw error;
      this.#handlers.fault(error.message);
    }
  }
}
