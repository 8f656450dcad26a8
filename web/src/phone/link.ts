/**
 * WebSocket connection of the phone page: sends the link's token, reconnects after a loss, and stops if no retry can
 * succeed.
 */

import { retryDelayMs, type Socket, type StreamClock } from "../net/stream";
import { CLOSE_CODES, type PhoneMessage, type PhoneStateMessage, WIRE_VERSION } from "../wire/messages";
import { parseToPhone, WireError } from "../wire/parse";

/** Status of the phone's connection to the server. */
export type LinkStatus = "connecting" | "open" | "lost" | "refused";

/** Callbacks of a {@link Link}. */
export interface LinkHandlers {
  status(status: LinkStatus, words: string): void;
  state(state: PhoneStateMessage): void;
}

/** `WebSocket.OPEN`, the state of a socket that can send. */
const OPEN = 1;
/**
 * Number of unsent bytes in the browser from which messages are discarded: the network is too slow, and an outdated
 * orientation is useless.
 */
const FULL_BYTES = 4096;
const USELESS = new Map<number, string>([
  [CLOSE_CODES["protocol.not-authorised"], "This link is no longer valid. Scan the code on the workstation again."],
  [CLOSE_CODES["protocol.taken-over"], "Another phone, or another page on this phone, has taken over."],
  [CLOSE_CODES["protocol.version"], "This page and Carina have different versions. Reload the page."],
  [CLOSE_CODES["protocol.malformed"], "Carina could not read a message from this page. Reload the page."],
]);

/** The phone's connection to the server, which reconnects after a loss. */
export class Link {
  readonly #connect: () => Socket & { readonly bufferedAmount: number };
  readonly #token: string;
  readonly #handlers: LinkHandlers;
  readonly #after: StreamClock["after"];
  #socket: (Socket & { readonly bufferedAmount: number }) | null = null;
  #isOpen = false;
  #attempt = 0;
  #callOff: (() => void) | null = null;

  constructor(
    connect: () => Socket & { readonly bufferedAmount: number },
    token: string,
    handlers: LinkHandlers,
    after: StreamClock["after"],
  ) {
    this.#connect = connect;
    this.#token = token;
    this.#handlers = handlers;
    this.#after = after;
  }

  open = (): void => {
    this.#callOff?.();
    this.#callOff = null;
    this.#isOpen = false;
    const previous = this.#socket;
    this.#socket = null;
    previous?.close();
    this.#handlers.status("connecting", "Connecting");
    const socket = this.#connect();
    this.#socket = socket;
    socket.onopen = () =>
      socket.send(JSON.stringify({ type: "phone_hello", wire_version: WIRE_VERSION, token: this.#token }));
    socket.onmessage = (event: { data: unknown }) => {
      if (this.#socket === socket && typeof event.data === "string") this.#receive(event.data);
    };
    socket.onclose = (event: { code: number }) => {
      if (this.#socket !== socket) return;
      this.#socket = null;
      this.#isOpen = false;
      const useless = USELESS.get(event.code);
      if (useless !== undefined) {
        this.#handlers.status("refused", useless);
        return;
      }
      this.#handlers.status("lost", "The workstation is not responding. Trying again.");
      this.#callOff = this.#after(retryDelayMs(this.#attempt), this.open);
      this.#attempt += 1;
    };
  };

  /** Send a message; return false if the message was discarded because it could not be sent now. */
  send = (message: PhoneMessage): boolean => {
    const socket = this.#socket;
    if (socket === null || !this.#isOpen || socket.readyState !== OPEN || socket.bufferedAmount > FULL_BYTES) {
      return false;
    }
    socket.send(JSON.stringify(message));
    return true;
  };

  close = (): void => {
    this.#callOff?.();
    this.#callOff = null;
    const socket = this.#socket;
    this.#socket = null;
    this.#isOpen = false;
    socket?.close();
  };

  #receive(text: string): void {
    try {
      const state = parseToPhone(text);
      if (!this.#isOpen) {
        this.#isOpen = true;
        this.#attempt = 0;
        this.#handlers.status("open", "");
      }
      this.#handlers.state(state);
    } catch (trouble) {
      if (!(trouble instanceof WireError)) throw trouble;
      this.#handlers.status("refused", "This page could not read a message from Carina. Reload the page.");
      this.close();
    }
  }
}
