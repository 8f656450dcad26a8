/** The socket: speaks the wire, comes back by itself when it is lost, and says honestly how it stands. */

import { CLOSE_CODES, type ClientMessage, NO_COMMANDS, type ServerMessage, WIRE_VERSION } from "../wire/messages";
import { parsePicture, parseServerMessage, WireError, type WirePicture } from "../wire/parse";

export type StreamStatus =
  | { status: "connecting" }
  | { status: "open" }
  | { status: "lost"; retryAtMs: number; reason: string | null }
  /** Trying again cannot help; a person must act. */
  | { status: "refused"; reason: string };

export interface StreamHandlers {
  status(status: StreamStatus): void;
  message(message: ServerMessage): void;
  picture(picture: WirePicture): void;
  /** The server broke the protocol; what it sent is dropped. */
  fault(words: string): void;
}

/** What the stream needs of a WebSocket; the browser's fits, and so does a fake one. */
export interface Socket {
  binaryType: string;
  readonly readyState: number;
  onopen: ((event: never) => void) | null;
  onmessage: ((event: never) => void) | null;
  onclose: ((event: never) => void) | null;
  send(text: string): void;
  close(): void;
}

export interface StreamClock {
  nowMs(): number;
  /** Calls back after a while; returns how to call it off. */
  after(ms: number, call: () => void): () => void;
}

const OPEN = 1;
const FIRST_RETRY_MS = 500;
const LAST_RETRY_MS = 8000;

/** Wait before the n-th try (0 is the first), doubling. */
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

  /** `token` is that of the link by which a watcher came. */
  constructor(connect: () => Socket, handlers: StreamHandlers, clock: StreamClock, token: string | null = null) {
    this.#token = token;
    this.#connect = connect;
    this.#handlers = handlers;
    this.#clock = clock;
  }

  /** Connects, now; also the "Try now" of a person who does not want to wait. */
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

  /** False where there is no connection: the message is not kept, since it would arrive as an old wish. */
  send = (message: ClientMessage): boolean => {
    if (this.#socket === null || this.#socket.readyState !== OPEN) return false;
    this.#socket.send(JSON.stringify(message));
    if (!NO_COMMANDS.includes(message.type)) this.#numCommands += 1;
    return true;
  };

  /** How many commands this connection has been sent; `handled` counts those that are done. */
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
