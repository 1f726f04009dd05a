import { Camera } from "./camera";
import { MapColours, Rgb, css, mix, rampColour } from "./colours";
import { byId, make, setText } from "./dom";
import { ViewName } from "./map_renderer";

const kBarWidth_px = 168;
const kBarHeight_px = 10;
const kWheel_px = 52;

// What the colours mean. `layerColour` is that of one of the layers drawn, null for the sum.
export function showLegend(view: ViewName, colours: MapColours, layerColour: Rgb | null): void {
  const parts = layerColour ? layerLegend(view, colours, layerColour) : sumLegend(view, colours);
  byId("legend").replaceChildren(...parts, unknownSwatch(view, colours));
}

function sumLegend(view: ViewName, colours: MapColours): HTMLElement[] {
  switch (view) {
    case "log_odds":
      return [
        scale((part) => rampColour(colours.logOdds, part), ["−10 free", "0", "occupied +10"]),
      ];
    case "contour":
      return [
        scale((part) => rampColour(colours.contour, part), ["free", "", "occupied"]),
        lines(colours.ink),
      ];
    case "gradient":
      return [wheel(colours)];
    default:
      return [
        scale(
          (part) => rampColour(colours.probability, part * (254 / 255)),
          ["0 free", "½", "occupied 1"],
        ),
      ];
  }
}

function layerLegend(view: ViewName, colours: MapColours, colour: Rgb): HTMLElement[] {
  const grey: Rgb = [140, 146, 152];
  if (view === "contour") return [lines(colour)];
  const bar = scale(
    (part) => mix(colours.paper, colour, 0.2 + 0.8 * part),
    ["free", "", "occupied"],
  );
  if (view !== "last_seen") return [bar];
  return [bar, scale((part) => mix(colour, grey, 0.65 * part), ["now", "", "1 h ago or more"])];
}

function scale(colourAt: (part: number) => Rgb, texts: [string, string, string]): HTMLElement {
  const bar = make("canvas", "legend-bar");
  bar.width = kBarWidth_px;
  bar.height = kBarHeight_px;
  const context = bar.getContext("2d")!;
  for (let x = 0; x < kBarWidth_px; ++x) {
    context.fillStyle = css(colourAt(x / (kBarWidth_px - 1)));
    context.fillRect(x, 0, 1, kBarHeight_px);
  }
  const labels = make("div", "legend-labels");
  labels.append(...texts.map((text) => make("span", "", text)));
  const element = make("div", "legend-scale");
  element.append(bar, labels);
  return element;
}

function lines(colour: Rgb): HTMLElement {
  const element = make("div", "legend-note");
  const line = make("span", "legend-line");
  line.style.backgroundColor = css(colour);
  element.append(line, make("span", "", "Log-odds 0: faces of things; faint: every 2.5"));
  return element;
}

function wheel({ direction, paper }: MapColours): HTMLElement {
  const canvas = make("canvas", "legend-wheel");
  canvas.width = canvas.height = kWheel_px * 2;
  const context = canvas.getContext("2d")!;
  const picture = context.createImageData(canvas.width, canvas.height);
  for (let k = 0; k < canvas.width * canvas.height; ++k) {
    const x = (k % canvas.width) / kWheel_px - 1;
    const y = 1 - Math.floor(k / canvas.width) / kWheel_px;
    if (Math.hypot(x, y) > 0.98) continue;
    const turn = (Math.atan2(y, x) / (2 * Math.PI) + 1) % 1;
    picture.data.set([...mix(paper, rampColour(direction, turn), Math.hypot(x, y)), 255], 4 * k);
  }
  context.putImageData(picture, 0, 0);
  const element = make("div", "legend-wheel-row");
  element.append(
    canvas,
    make(
      "span",
      "legend-text",
      "Hue: which way log-odds rise, towards obstacles. Pale: level ground.",
    ),
  );
  return element;
}

function unknownSwatch(view: ViewName, colours: MapColours): HTMLElement {
  const box = make("span", "swatch unknown");
  box.style.backgroundColor = css(colours.unknown);
  if (view !== "probability") {
    const [line, ground] = [css(colours.hatch), css(colours.unknown)];
    const stripes = `${line} 0 2px, ${ground} 2px 5px`;
    box.style.backgroundImage = `repeating-linear-gradient(135deg, ${stripes})`;
  }
  const element = make("div", "legend-note");
  element.append(box, make("span", "", "Never seen"));
  return element;
}

const kScaleBar_px = 130;

export function showScaleBar({ view }: Camera): void {
  const greatest_m = kScaleBar_px * view.metres_per_pixel;
  const power = 10 ** Math.floor(Math.log10(greatest_m));
  const length_m = power * ([5, 2, 1].find((step) => step * power <= greatest_m) ?? 1);
  byId("scale-bar").style.width = `${length_m / view.metres_per_pixel}px`;
  setText(byId("scale-text"), lengthText(length_m));
}

function lengthText(length_m: number): string {
  if (length_m >= 1000) return `${length_m / 1000} km`;
  if (length_m >= 1) return `${length_m} m`;
  return length_m >= 0.01
    ? `${Math.round(100 * length_m)} cm`
    : `${Number((1000 * length_m).toFixed(1))} mm`;
}
