// Colours of the map, computed in OKLab, where equal steps look equal (B. Ottosson, 2020).

export type Rgb = [number, number, number]; // 0..255
export type Theme = "light" | "dark";
export const kRampSize = 256;

type Lab = [number, number, number];

function toLinear(value: number): number {
  const v = value / 255;
  return v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4;
}

function toByte(linear: number): number {
  const v = Math.min(Math.max(linear, 0), 1);
  return Math.round(255 * (v <= 0.0031308 ? 12.92 * v : 1.055 * v ** (1 / 2.4) - 0.055));
}

function labOf(rgb: Rgb): Lab {
  const [r, g, b] = [toLinear(rgb[0]), toLinear(rgb[1]), toLinear(rgb[2])];
  const l = Math.cbrt(0.4122214708 * r + 0.5363325363 * g + 0.0514459929 * b);
  const m = Math.cbrt(0.2119034982 * r + 0.6806995451 * g + 0.1073969566 * b);
  const s = Math.cbrt(0.0883024619 * r + 0.2817188376 * g + 0.6299787005 * b);
  return [
    0.2104542553 * l + 0.793617785 * m - 0.0040720468 * s,
    1.9779984951 * l - 2.428592205 * m + 0.4505937099 * s,
    0.0259040371 * l + 0.7827717662 * m - 0.808675766 * s,
  ];
}

function rgbOf([L, a, b]: Lab): Rgb {
  const l = (L + 0.3963377774 * a + 0.2158037573 * b) ** 3;
  const m = (L - 0.1055613458 * a - 0.0638541728 * b) ** 3;
  const s = (L - 0.0894841775 * a - 1.291485548 * b) ** 3;
  return [
    toByte(4.0767416621 * l - 3.3077115913 * m + 0.2309699292 * s),
    toByte(-1.2684380046 * l + 2.6097574011 * m - 0.3413193965 * s),
    toByte(-0.0041960863 * l - 0.7034186147 * m + 1.707614701 * s),
  ];
}

export function mix(from: Rgb, to: Rgb, part: number): Rgb {
  const [a, b] = [labOf(from), labOf(to)];
  const between = (k: 0 | 1 | 2) => a[k] + (b[k] - a[k]) * part;
  return rgbOf([between(0), between(1), between(2)]);
}

function hue(lightness: number, chroma: number, turn: number): Rgb {
  const angle = 2 * Math.PI * turn;
  return rgbOf([lightness, chroma * Math.cos(angle), chroma * Math.sin(angle)]);
}

export function css([r, g, b]: Rgb, alpha = 1): string {
  return `rgba(${r}, ${g}, ${b}, ${alpha})`;
}

// Bytes of kRampSize colours, RGBA, through `stops` at equal distances.
function ramp(stops: Rgb[]): Uint8Array {
  const bytes = new Uint8Array(4 * kRampSize);
  for (let k = 0; k < kRampSize; ++k) {
    const at = (k / (kRampSize - 1)) * (stops.length - 1);
    const stop = Math.min(Math.floor(at), stops.length - 2);
    bytes.set([...mix(stops[stop]!, stops[stop + 1]!, at - stop), 255], 4 * k);
  }
  return bytes;
}

// Grey k is that of round(254 p) = k, as in the pictures of splinemap.
function greyRamp(): Uint8Array {
  const bytes = new Uint8Array(4 * kRampSize).fill(255);
  for (let k = 0; k < kRampSize; ++k) bytes.fill(255 - k, 4 * k, 4 * k + 3);
  return bytes;
}

function hueRamp(lightness: number, chroma: number): Uint8Array {
  const bytes = new Uint8Array(4 * kRampSize);
  for (let k = 0; k < kRampSize; ++k) {
    bytes.set([...hue(lightness, chroma, k / kRampSize + 0.08), 255], 4 * k);
  }
  return bytes;
}

// What the map is drawn with in one theme.
export interface MapColours {
  unknown: Rgb;
  hatch: Rgb;
  paper: Rgb; // free, and no slope
  ink: Rgb; // level lines and text over the map
  probability: Uint8Array; // ramps: of round(254 p),
  logOdds: Uint8Array; // of log-odds from -kLogOddsRange to kLogOddsRange,
  contour: Uint8Array; // of the same, softer,
  direction: Uint8Array; // of a full turn from +x
}

export const kLogOddsRange = 10;

const kLight: MapColours = {
  unknown: [176, 190, 205],
  hatch: [158, 174, 192],
  paper: [250, 251, 252],
  ink: [22, 28, 36],
  probability: greyRamp(),
  logOdds: ramp([
    [22, 78, 146],
    [96, 160, 214],
    [247, 247, 245],
    [240, 160, 80],
    [160, 72, 6],
  ]),
  contour: ramp([
    [214, 229, 243],
    [226, 236, 246],
    [250, 249, 246],
    [250, 226, 198],
    [244, 205, 164],
  ]),
  direction: hueRamp(0.66, 0.15),
};

const kDark: MapColours = {
  unknown: [23, 28, 36],
  hatch: [35, 42, 53],
  paper: [52, 59, 70],
  ink: [240, 243, 247],
  probability: ramp([
    [52, 59, 70],
    [112, 120, 132],
    [246, 248, 250],
  ]),
  logOdds: ramp([
    [92, 150, 208],
    [48, 96, 150],
    [56, 60, 66],
    [186, 104, 32],
    [255, 190, 120],
  ]),
  contour: ramp([
    [40, 58, 80],
    [44, 58, 76],
    [58, 60, 64],
    [88, 66, 46],
    [108, 74, 44],
  ]),
  direction: hueRamp(0.72, 0.14),
};

export const kMapColours: Record<Theme, MapColours> = { light: kLight, dark: kDark };

// For layers and robots, in the order in which they came: told apart by those who are colour-blind
// too (M. Okabe and K. Ito), then lighter and darker ones of the same hues.
const kCategories: Rgb[] = [
  [0, 114, 178],
  [213, 94, 0],
  [0, 158, 115],
  [204, 121, 167],
  [230, 159, 0],
  [86, 180, 233],
  [148, 103, 189],
  [140, 120, 60],
];

export function categoryColour(index: number, theme: Theme = "light"): Rgb {
  const white: Rgb = [255, 255, 255];
  const colour = kCategories[index % kCategories.length]!;
  const round = Math.floor(index / kCategories.length);
  const varied = round === 0 ? colour : mix(colour, round % 2 === 1 ? white : [0, 0, 0], 0.35);
  return theme === "dark" ? mix(varied, white, 0.25) : varied;
}

export function rampColour(bytes: Uint8Array, part: number): Rgb {
  const k = 4 * Math.round(Math.min(Math.max(part, 0), 1) * (kRampSize - 1));
  return [bytes[k]!, bytes[k + 1]!, bytes[k + 2]!];
}
