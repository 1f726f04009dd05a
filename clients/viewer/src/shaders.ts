import { kLogOddsRange } from "./colours";
import { kTileSide } from "./frame";

// How a tile is coloured; the values of `style` in the fragment shader.
export const kStyle = {
  probability: 0,
  logOdds: 1,
  contour: 2,
  gradient: 3,
  newest: 4,
  tint: 5,
  lines: 6,
};

// Half a turn of the hatch over unknown ground.
export const kHatch_px = 7;

// Lengths are in knots of the level, from the control point (0, 0) of the tile `anchor`, which is
// at the lower left corner of the picture: floats are exact enough there wherever the map is.
//
// A tile is drawn half a knot to the lower left of its control points, so that the control point
// nearest to each of its pixels, the one that tells whether they are known, is its own.
export const kTileVertexShader = `#version 300 es
precision highp float;
precision highp int;
layout(location = 0) in ivec2 tile;  // minus anchor
layout(location = 1) in ivec2 texel; // of its control point (0, 0) in the atlas
layout(location = 2) in float depth;
layout(location = 3) in float vividness;
uniform vec2 corner;       // the lower left corner of the picture
uniform vec2 picture_size;
flat out vec2 corner_in_tile;
flat out ivec2 first_texel;
flat out float vivid;
void main() {
  ivec2 vertex = ivec2(gl_VertexID & 1, gl_VertexID >> 1);
  vec2 at = ${kTileSide}.0 * vec2(tile + vertex) - 0.5 - corner;
  gl_Position = vec4(2.0 * at / picture_size - 1.0, depth, 1.0);
  corner_in_tile = corner - ${kTileSide}.0 * vec2(tile);
  first_texel = texel;
  vivid = vividness;
}`;

// The surface is s(u) = sum_kl b_k(t_x) b_l(t_y) c[i - 1 + k, j - 1 + l], u = (i, j) + t, with the
// weights of a uniform cubic B-spline.
export const kTileFragmentShader = `#version 300 es
precision highp float;
precision highp int;
precision highp isampler2D;
uniform isampler2D atlas;
uniform sampler2D ramp;
uniform int style;
uniform float knots_per_pixel;
uniform float steep;  // the slope in log-odds per knot that is drawn in full
uniform float density; // pixels of the screen per pixel of CSS
uniform vec3 colour;  // of the layer
uniform vec3 paper;
uniform vec3 line;
flat in vec2 corner_in_tile;
flat in ivec2 first_texel;
flat in float vivid;
out vec4 pixel;

vec4 weights(float t) {
  float r = 1.0 - t;
  return vec4(r * r * r, (3.0 * t - 6.0) * t * t + 4.0, ((-3.0 * t + 3.0) * t + 3.0) * t + 1.0,
              t * t * t) / 6.0;
}

vec4 slopes(float t) {
  float r = 1.0 - t;
  return vec4(-r * r, (3.0 * t - 4.0) * t, (-3.0 * t + 2.0) * t + 1.0, t * t) / 2.0;
}

float control_point(ivec2 at) { return float(texelFetch(atlas, first_texel + at, 0).r); }

// The gradient per knot, and the value.
vec3 evaluate(vec2 u) {
  ivec2 i = clamp(ivec2(floor(u)), -1, ${kTileSide - 1});
  vec2 t = u - vec2(i);
  vec4 wx = weights(t.x);
  vec4 wy = weights(t.y);
  vec4 dx = slopes(t.x);
  vec4 dy = slopes(t.y);
  vec3 sum = vec3(0.0);
  for (int l = 0; l < 4; ++l) {
    ivec2 at = i + ivec2(-1, l - 1);
    vec4 row = vec4(control_point(at), control_point(at + ivec2(1, 0)),
                    control_point(at + ivec2(2, 0)), control_point(at + ivec2(3, 0)));
    float value = dot(wx, row);
    sum += vec3(wy[l] * dot(dx, row), dy[l] * value, wy[l] * value);
  }
  return sum / 256.0;
}

vec3 of_ramp(int k) { return texelFetch(ramp, ivec2(k, 0), 0).rgb; }

vec3 of_log_odds(float s) {
  return of_ramp(int(clamp(s / ${2 * kLogOddsRange}.0 + 0.5, 0.0, 1.0) * 255.0 + 0.5));
}

// How much a line of the level covers the pixel.
float cover(float distance, float slope_per_pixel, float width) {
  float from_line_px = abs(distance) / max(slope_per_pixel, 1e-6);
  return 1.0 - smoothstep(0.5 * width - 0.5, 0.5 * width + 0.5, from_line_px);
}

// Whether all control points around are touched. The surface falls to 0 beyond, which is no face.
bool is_within(vec2 u) {
  ivec2 i = clamp(ivec2(floor(u)), -1, ${kTileSide - 1});
  return control_point(i) != 0.0 && control_point(i + ivec2(1, 0)) != 0.0 &&
         control_point(i + ivec2(0, 1)) != 0.0 && control_point(i + ivec2(1, 1)) != 0.0;
}

// Faint lines are 2.5 apart. They vanish where they would lie too dense, and on plains, where noise
// alone makes them.
float line_cover(vec2 u, vec3 surface) {
  if (!is_within(u)) return 0.0;
  float slope = length(surface.xy);
  float slope_per_pixel = slope * knots_per_pixel;
  float plain = smoothstep(0.15, 0.6, slope);
  float strong = cover(surface.z, slope_per_pixel, 2.0 * density) * plain;
  float apart_px = 2.5 / max(slope_per_pixel, 1e-6) / density;
  float nearest = round(surface.z / 2.5) * 2.5;
  float faint = cover(surface.z - nearest, slope_per_pixel, density);
  return max(strong, 0.35 * faint * plain * smoothstep(3.0, 9.0, apart_px));
}

vec3 of_gradient(vec2 gradient) {
  float turn = atan(gradient.y, gradient.x) / 6.283185307;
  vec3 direction = of_ramp(int(floor(turn * 256.0 + 0.5)) & 255);
  return mix(paper, direction, smoothstep(0.02, 1.0, length(gradient) / steep));
}

// The layer's colour: a tint where it is free, in full where it is occupied.
vec3 of_layer(float p) {
  vec3 faded = mix(vec3(dot(colour, vec3(0.3, 0.6, 0.1))), colour, 0.35 + 0.65 * vivid);
  vec3 tint = mix(paper, faded, 0.16 + 0.26 * vivid);
  return mix(tint, mix(faded, line, 0.25), p);
}

void main() {
  vec2 u = corner_in_tile + gl_FragCoord.xy * knots_per_pixel;
  ivec2 nearest = clamp(ivec2(floor(u + 0.5)), -1, ${kTileSide});
  if (control_point(nearest) == 0.0) discard; // never seen
  vec3 surface = evaluate(u);
  float p = 1.0 / (1.0 + exp(-surface.z));
  vec4 drawn = vec4(0.0, 0.0, 0.0, 1.0);
  if (style == ${kStyle.probability}) {
    drawn.rgb = of_ramp(int(254.0 * p + 0.5));
  } else if (style == ${kStyle.logOdds}) {
    drawn.rgb = of_log_odds(surface.z);
  } else if (style == ${kStyle.contour}) {
    drawn.rgb = mix(of_log_odds(surface.z), line, line_cover(u, surface));
  } else if (style == ${kStyle.gradient}) {
    drawn.rgb = of_gradient(surface.xy);
  } else if (style == ${kStyle.newest}) {
    drawn.rgb = of_layer(p);
  } else { // blended over the other layers
    bool is_tint = style == ${kStyle.tint};
    float alpha = is_tint ? mix(0.2, 1.0, p) : max(0.12, line_cover(u, surface));
    drawn = vec4(colour * alpha, alpha);
  }
  pixel = drawn;
}`;

// One triangle over the picture.
export const kUnknownVertexShader = `#version 300 es
void main() {
  vec2 at = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0;
  gl_Position = vec4(at, 1.0, 1.0);
}`;

// A hatch that stays with the map when it is moved.
export const kUnknownFragmentShader = `#version 300 es
precision highp float;
uniform vec3 unknown;
uniform vec3 hatch;
uniform float period;
uniform float offset;
out vec4 pixel;
void main() {
  float from_line = abs(mod(gl_FragCoord.x + gl_FragCoord.y + offset, period) - 0.5 * period);
  pixel = vec4(mix(hatch, unknown, smoothstep(0.4, 1.4, from_line)), 1.0);
}`;
