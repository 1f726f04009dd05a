// The server's questions and commands over HTTP. Failures are Errors with a sentence for people.

export interface LayerSample {
  key: string;
  name: string;
  known: boolean;
  log_odds: number;
  is_summed: boolean;
}

export interface QueryAnswer {
  x_m: number;
  y_m: number;
  revision: number;
  known: boolean;
  log_odds: number;
  probability: number;
  gradient_per_m: [number, number];
  layers: LayerSample[];
}

export interface CheckAnswer {
  occupancy: "free" | "occupied" | "unknown";
  is_certified: boolean;
  free_m: number;
  contact: { x_m: number; y_m: number } | null;
}

export class Api {
  constructor(private readonly token: string) {}

  query(x: number, y: number): Promise<QueryAnswer> {
    return this.ask<QueryAnswer>("api/query", { x, y });
  }

  check(x0: number, y0: number, x1: number, y1: number, radius: number): Promise<CheckAnswer> {
    return this.ask<CheckAnswer>("api/check", { x0, y0, x1, y1, radius });
  }

  async sendGoal(x_m: number, y_m: number, yaw_rad: number): Promise<void> {
    await this.post("api/goal", { x_m, y_m, yaw_rad });
  }

  async mute(layer: string, muted: boolean): Promise<void> {
    await this.post("api/mute", { layer, muted });
  }

  private async ask<T>(path: string, parameters: Record<string, number>): Promise<T> {
    const url = new URL(path, location.href);
    for (const [name, value] of Object.entries(parameters)) {
      url.searchParams.set(name, String(value));
    }
    return (await this.fetch(url, {})).json() as Promise<T>;
  }

  private post(path: string, body: object): Promise<Response> {
    return this.fetch(new URL(path, location.href), {
      method: "POST",
      body: JSON.stringify(body),
      headers: { "Content-Type": "application/json" },
    });
  }

  private async fetch(url: URL, options: RequestInit): Promise<Response> {
    const headers = new Headers(options.headers);
    if (this.token) headers.set("Authorization", `Bearer ${this.token}`);
    let response: Response;
    try {
      response = await fetch(url, { ...options, headers });
    } catch {
      throw new Error("The server does not answer.");
    }
    if (!response.ok) throw new Error(await errorOf(response));
    return response;
  }
}

async function errorOf(response: Response): Promise<string> {
  if (response.status === 401) return "The token is missing or wrong.";
  try {
    const { error } = (await response.json()) as { error?: unknown };
    if (typeof error === "string" && error) return error;
  } catch {
    // Not JSON: the status has to do.
  }
  return `The server refused this (status ${response.status}).`;
}
