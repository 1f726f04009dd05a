import { LayerSample, QueryAnswer } from "./api";
import { Rgb } from "./colours";
import { byId, make, setText, swatch } from "./dom";
import { Tools, lengthOf } from "./tools";
import * as words from "./words";

type Row = [string, string];

interface Content {
  title: string;
  text: string;
  rows: Row[];
  layers: LayerSample[];
  tone: string;
}

// Says what the tool found, or what it waits for.
export class Card {
  private shown = "";

  constructor(private readonly colourOf: (layer: string) => Rgb) {}

  show(tools: Tools): void {
    const content = contentOf(tools);
    byId("card").hidden = content === null;
    byId("radius-row").hidden = tools.active !== "segment";
    const shown = JSON.stringify(content);
    if (!content || shown === this.shown) return;
    this.shown = shown;
    setText(byId("card-title"), content.title);
    const text = byId("card-text");
    setText(text, content.text);
    text.hidden = !content.text;
    byId("card").dataset.tone = content.tone;
    byId("card-rows").replaceChildren(
      ...content.rows.flatMap(([name, value]) => [make("dt", "", name), make("dd", "", value)]),
    );
    byId("card-layers").replaceChildren(...content.layers.map((layer) => this.layerRow(layer)));
  }

  private layerRow(layer: LayerSample): HTMLElement {
    const row = make("div", "card-layer");
    const value = layer.known ? words.signed(layer.log_odds) : "never seen";
    const note = layer.is_summed ? "" : " (not in the map)";
    row.append(
      swatch(this.colourOf(layer.key)),
      make("span", "name", layer.name + note),
      make("span", "value", value),
    );
    return row;
  }
}

function contentOf(tools: Tools): Content | null {
  const content = { title: "", text: tools.error, rows: [], layers: [], tone: "" };
  if (tools.goal) return { ...content, ...goalContent(tools) };
  switch (tools.active) {
    case "inspect":
      return tools.inspected ? { ...content, ...inspectContent(tools) } : null;
    case "measure":
      return { ...content, ...measureContent(tools) };
    case "segment":
      return { ...content, ...segmentContent(tools) };
    case "goal": {
      const text = "Click where the robot shall go, or drag for its heading there.";
      return { ...content, title: "Goal", text };
    }
  }
}

function goalContent({ goal, error, isGoalSent }: Tools): Partial<Content> {
  const { x_m, y_m, yaw_rad } = goal!;
  const rows: Row[] = [
    ["Position", `${words.place(x_m, y_m)} m`],
    ["Heading", words.degrees(yaw_rad)],
  ];
  const text = error || (isGoalSent ? "Sent." : "");
  return { title: "Goal", text, rows, tone: error ? "bad" : isGoalSent ? "ok" : "" };
}

function inspectContent({ inspected, sample, error }: Tools): Partial<Content> {
  const { x_m, y_m } = inspected!;
  const title = `${words.place(x_m, y_m)} m`;
  if (!sample) return { title, text: error || "Asking …", tone: error ? "bad" : "" };
  return {
    title,
    text: error || knowledge(sample),
    rows: sampleRows(sample),
    layers: sample.layers,
  };
}

function knowledge({ known, probability }: QueryAnswer): string {
  if (!known) return "Never seen.";
  if (probability < 0.3) return "Seen, free.";
  return probability > 0.7 ? "Seen, occupied." : "Seen, undecided.";
}

function sampleRows(sample: QueryAnswer): Row[] {
  const [gx, gy] = sample.gradient_per_m;
  const slope = Math.hypot(gx, gy);
  const towards = slope > 0 ? ` towards ${words.degrees(Math.atan2(gy, gx))}` : "";
  return [
    ["Probability", sample.probability.toFixed(3)],
    ["Log-odds", words.signed(sample.log_odds)],
    ["Gradient", `${slope.toFixed(1)} /m${towards}`],
  ];
}

function measureContent({ measured, hover }: Tools): Partial<Content> {
  const points = measured.length === 1 && hover ? [...measured, hover] : measured;
  const [from, to] = points;
  if (!from || !to)
    return { title: "Measure", text: from ? "Click the other end." : "Click two points." };
  const angle_rad = Math.atan2(to.y_m - from.y_m, to.x_m - from.x_m);
  const rows: Row[] = [
    ["Distance", words.metres(lengthOf(points))],
    ["Along x, y", `${words.signed(to.x_m - from.x_m)}, ${words.signed(to.y_m - from.y_m)} m`],
    ["Bearing", words.degrees(angle_rad)],
  ];
  return { title: "Measure", rows };
}

const kTones = { free: "ok", occupied: "bad", unknown: "warn" };

function segmentContent({ segment, check, radius_m, error }: Tools): Partial<Content> {
  const title = "Check a segment";
  if (error) return { title, text: error, tone: "bad" };
  if (segment.length === 0)
    return { title, text: "Click two points: may a disc go from one to the other?" };
  if (segment.length === 1) return { title, text: "Click the other end." };
  if (!check) return { title, text: "Asking …" };
  const tone = check.occupancy === "free" && !check.is_certified ? "warn" : kTones[check.occupancy];
  return { title, text: words.checkSentence(check, radius_m, lengthOf(segment)), tone };
}
