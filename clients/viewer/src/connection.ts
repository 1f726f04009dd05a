import { Box, Frame, decodeFrame } from "./frame";

export type ConnectionState = "connecting" | "open" | "lost" | "refused";

export interface ViewRequest extends Box {
  level: number;
  surfaces: string[];
}

interface Handlers {
  onOpen(): void; // a server, perhaps another one: what was known is void
  onFrame(frame: Frame): void;
  onState(state: ConnectionState): void;
  onError(text: string): void;
}

const kFirstRetry_ms = 500;
const kLastRetry_ms = 5000;
const kSilence_ms = 10_000;
const kProbeTimeout_ms = 5000;

// The socket to the server; connects again, later and later, when it closes. A socket that says
// nothing for long is tested over HTTP, since a computer that slept does not learn that it is dead.
export class Connection {
  private socket: WebSocket | null = null;
  private retry_ms = kFirstRetry_ms;
  private lastHeard_ms = 0;

  constructor(
    private readonly token: string,
    private readonly handlers: Handlers,
  ) {
    setInterval(() => void this.testSilence(), kSilence_ms / 2);
  }

  connect(): void {
    const url = new URL("live", location.href);
    url.protocol = location.protocol === "https:" ? "wss:" : "ws:";
    url.search = this.token ? `?token=${encodeURIComponent(this.token)}` : "";
    url.hash = "";
    const socket = new WebSocket(url);
    socket.binaryType = "arraybuffer";
    socket.onopen = () => this.handleOpen();
    socket.onmessage = (event) => this.handleMessage(socket, event.data);
    socket.onclose = () => void this.handleClose(socket);
    this.socket = socket;
  }

  sendView(view: ViewRequest): void {
    this.send({ view });
  }

  // Null: now.
  sendTime(at_utime: number | null): void {
    this.send({ at_utime });
  }

  isOpen(): boolean {
    return this.socket?.readyState === WebSocket.OPEN;
  }

  private send(message: object): void {
    if (this.isOpen()) this.socket!.send(JSON.stringify(message));
  }

  private handleOpen(): void {
    this.lastHeard_ms = performance.now();
    this.handlers.onState("open");
    this.handlers.onOpen();
  }

  private handleMessage(socket: WebSocket, data: unknown): void {
    if (socket !== this.socket || !(data instanceof ArrayBuffer)) return;
    this.lastHeard_ms = performance.now();
    try {
      const frame = decodeFrame(data);
      this.handlers.onFrame(frame);
      this.send({ ack: frame.frame });
      this.retry_ms = kFirstRetry_ms;
    } catch (error) {
      this.handlers.onError(`A frame cannot be read: ${String(error)}`);
      socket.close();
    }
  }

  private async handleClose(socket: WebSocket): Promise<void> {
    if (socket !== this.socket) return;
    this.socket = null;
    this.handlers.onState("lost");
    setTimeout(() => this.connect(), this.retry_ms);
    this.retry_ms = Math.min(2 * this.retry_ms, kLastRetry_ms);
    // A socket does not tell why it was refused.
    if ((await this.probe()) === 401 && !this.isOpen()) this.handlers.onState("refused");
  }

  private async testSilence(): Promise<void> {
    if (!this.isOpen() || performance.now() - this.lastHeard_ms < kSilence_ms) return;
    const socket = this.socket!;
    if ((await this.probe()) !== 0 || socket !== this.socket) return;
    socket.onclose = null;
    socket.close();
    void this.handleClose(socket);
  }

  // The HTTP status of a small request, 0 without an answer.
  private async probe(): Promise<number> {
    const url = new URL("api/query?x=0&y=0", location.href);
    if (this.token) url.searchParams.set("token", this.token);
    try {
      return (await fetch(url, { signal: AbortSignal.timeout(kProbeTimeout_ms) })).status;
    } catch {
      return 0;
    }
  }
}
