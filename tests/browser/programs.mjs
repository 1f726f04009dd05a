// Programs that the cases start, and end by themselves.
import { spawn, spawnSync } from "node:child_process";
import { setTimeout as sleep } from "node:timers/promises";

const kLongest_ms = 60_000;

// Until it gives something true, which is returned; `what` is told where it never does.
export async function until(what, condition) {
  const deadline_ms = Date.now() + kLongest_ms;
  for (;;) {
    const found = await condition();
    if (found) return found;
    if (Date.now() > deadline_ms) throw new Error(`did not come true in 60 s: ${what}`);
    await sleep(50);
  }
}

// What a command prints. Commands that fail may be wanted: check has a status for what is blocked.
export function output(command, args, { input = "", status = 0 } = {}) {
  const ended = spawnSync(command, args, { input, encoding: "utf8", maxBuffer: 1 << 28 });
  if (ended.status === status) return ended.stdout;
  throw new Error(`${command} ${args.join(" ")}: status ${ended.status}: ${ended.stderr}`);
}

export class Program {
  constructor(command, ...args) {
    this.log = "";
    this.child = spawn(command, args, { stdio: ["ignore", "ignore", "pipe"] });
    this.child.stderr.setEncoding("utf8").on("data", (text) => (this.log += text));
    this.ended = new Promise((resolve) => this.child.on("close", resolve));
  }

  async says(pattern) {
    const found = await until(`${this.child.spawnfile} says ${pattern}`, () => pattern.exec(this.log));
    return found[1];
  }

  async end(signal = "SIGTERM") {
    this.child.kill(signal);
    return await this.ended;
  }
}

// A viewer at a port of its own, or again at one that is told.
export class ViewerProgram extends Program {
  constructor({ port = 0, flags = [] } = {}) {
    super("splinemap-viewer", "--port", String(port), ...flags);
  }

  async url() {
    return await this.says(/The map is at (\S+)/);
  }
}
