package splinemap.spy;

import java.util.ArrayList;
import java.util.HashMap;
import java.util.HashSet;
import java.util.LinkedHashMap;
import java.util.List;
import java.util.Map;
import java.util.Set;
import splinemap.control_records_t;
import splinemap.layer_control_t;
import splinemap.layer_digest_t;
import splinemap.layer_epoch_t;
import splinemap.layer_listing_t;
import splinemap.layer_pull_t;
import splinemap.layer_updates_t;
import splinemap.stand_in_digest_t;

/** The sum of all layers on a bus, as people have decided, as far as it has come. Thread-safe. */
final class MapCopy {
  private static final int MAX_LAYERS = 256;
  private static final int MAX_CONTROLS = 1024;
  // Decisions are told when they are new, and to who asks. Of a telling in pieces one may be lost.
  private static final long ASK_MS = 1000;
  private static final long ASK_AGAIN_MS = 30_000;
  private static final long MAX_SILENCE_MS = 3500;  // who says nothing for so long is gone
  // A layer of a name that another one has taken is forgotten after that.
  private static final long FORGET_AFTER_MS = 10_000;
  // Whatever is on the bus, lcm-spy keeps half of its memory: a tile may be there three times.
  private static final int MAX_TILES = (int) Math.min(
      1 << 20, Runtime.getRuntime().maxMemory() / 2 / (3 * TileCode.BYTES + 1024));

  private record LayerId(String name, long origin) {}

  private final Map<LayerId, LayerCopy> layers = new LinkedHashMap<>();
  private final Map<LayerId, LayerControl> controls = new HashMap<>();
  private long heard_hash;  // of all decisions that others know; 0 where there are none
  private long told_hash;   // the last with which decisions came
  private long asked_ms = Long.MIN_VALUE / 2;
  private layer_digest_t format;  // the first digest: its knot interval and limits hold for all
  private boolean has_other_formats;
  private final Map<Node, short[]> merged = new HashMap<>();
  private KnotBox touched = KnotBox.EMPTY;
  private boolean begins_anew;  // all sums: other layers or decisions
  private long changed_ms;      // requires !merged.isEmpty()

  synchronized void takeDigest(layer_digest_t digest, long now_ms) {
    LayerCopy layer = layerOf(digest);
    if (layer == null) return;
    layer.takeDigest(digest, now_ms);
    if (layer.inSync()) forgetReplaced(id(digest.layer), now_ms);
  }

  synchronized void takeStandInDigest(stand_in_digest_t stand_in, long now_ms) {
    LayerCopy layer = layerOf(stand_in.digest);
    if (layer == null) return;
    layer.takeStandInDigest(stand_in, now_ms);
    if (layer.inSync()) forgetReplaced(id(stand_in.digest.layer), now_ms);
  }

  private LayerCopy layerOf(layer_digest_t digest) {
    LayerId id = id(digest.layer);
    if (digest.protocol_version != 1 || control(id).isRemoved(digest.layer)) return null;
    if (format == null) format = digest;
    if (digest.knot_interval_m != format.knot_interval_m
        || digest.min_control_point != format.min_control_point
        || digest.max_control_point != format.max_control_point) {
      has_other_formats = true;
      return null;
    }
    if (!layers.containsKey(id) && layers.size() >= MAX_LAYERS) return null;
    return layers.computeIfAbsent(id, key -> new LayerCopy(this::isFull));
  }

  synchronized void takeControls(control_records_t message) {
    if (message.hash != 0) heard_hash = message.hash;
    if (message.num_records > 0) told_hash = message.hash;
    for (layer_control_t record : message.records) {
      LayerId id = new LayerId(record.name, record.origin);
      LayerControl control = LayerControl.of(record);
      if (!control.isValid() || (!controls.containsKey(id) && controls.size() >= MAX_CONTROLS)) {
        continue;
      }
      LayerControl merged = control(id).merge(control);
      begins_anew |= !merged.equals(control(id));
      controls.put(id, merged);
    }
    if (!begins_anew) return;
    layers.entrySet().removeIf(
        layer -> layer.getValue().isRemovedBy(control(layer.getKey())));
  }

  /** Whether to ask for decisions now: to tell that none are known. Call it some times a second. */
  synchronized boolean asksForControls(long now_ms) {
    long pause_ms = heard_hash == told_hash ? ASK_AGAIN_MS : ASK_MS;
    if (heard_hash == 0 || now_ms - asked_ms < pause_ms) return false;
    asked_ms = now_ms;
    return true;
  }

  synchronized void takeUpdates(layer_updates_t updates) {
    LayerCopy layer = layers.get(id(updates.layer));
    if (layer != null) layer.takeUpdates(updates);
  }

  synchronized void takeListing(layer_listing_t listing, long now_ms) {
    LayerCopy layer = layers.get(id(listing.layer));
    if (layer != null) layer.takeListing(listing, now_ms);
  }

  synchronized List<layer_pull_t> pulls(long now_ms) {
    List<layer_pull_t> pulls = new ArrayList<>();
    for (LayerCopy layer : layers.values()) pulls.addAll(layer.pulls(now_ms));
    return pulls;
  }

  /** Merges what has come; true where something has. */
  synchronized boolean refresh(long now_ms) {
    Set<Node> changed = new HashSet<>();
    layers.forEach((id, layer) -> {
      LayerControl control = control(id);
      Set<Node> of_layer = layer.takeChanged();
      for (Node tile : begins_anew ? layer.tiles() : of_layer) {
        changed.addAll(TileRows.keysOfShifted(tile, control.shift_i(), control.shift_j()));
      }
    });
    boolean is_new = begins_anew || !changed.isEmpty();
    boolean shrinks = begins_anew;
    if (begins_anew) merged.clear();
    begins_anew = false;
    for (Node tile : changed) {
      short[] points = mergedPoints(tile);
      if (points == null) {
        shrinks |= merged.remove(tile) != null;
      } else {
        merged.put(tile, points);
        touched = touched.with(tile, points);
      }
    }
    if (shrinks) {
      touched = KnotBox.EMPTY;
      merged.forEach((tile, points) -> touched = touched.with(tile, points));
    }
    if (is_new) changed_ms = now_ms;
    return is_new;
  }

  /** Control points of the map, row-major, 1/256 log-odds, 0 for never seen; null for no tile. */
  synchronized short[] points(Node tile) {
    return merged.get(tile);
  }

  synchronized KnotBox touched() {
    return touched;
  }

  synchronized double knotIntervalM() {
    return format == null ? 1 : format.knot_interval_m;
  }

  /** The surface at a point, in log-odds; NaN where it was never seen. */
  synchronized double logOdds(double x_m, double y_m) {
    double x = x_m / knotIntervalM();
    SurfaceRow surface = new SurfaceRow(this, x, x);
    surface.moveTo(y_m / knotIntervalM());
    return surface.at(x);
  }

  /** What there is, in words. */
  synchronized String status(long now_ms) {
    if (layers.isEmpty()) return "No daemon was heard yet";
    long match_ms = now_ms;
    long heard_ms = now_ms;
    for (LayerCopy layer : layers.values()) {
      match_ms = Math.min(match_ms, layer.matchMs());
      heard_ms = Math.min(heard_ms, layer.spokenForMs());
    }
    String text = layers.size() == 1 ? "1 layer, " : layers.size() + " layers, ";
    long left_out = layers.keySet().stream().filter(id -> !control(id).isSummed()).count();
    if (left_out > 0) text += left_out + " left out, ";
    text += merged.size() + " tiles";
    // While much changes, a digest is seldom the same as what is there.
    text += match_ms > Math.min(heard_ms, now_ms) - MAX_SILENCE_MS ? ", whole" : ", not yet whole";
    if (!merged.isEmpty()) text += ", changed " + age(now_ms - changed_ms) + " ago";
    if (now_ms - heard_ms > MAX_SILENCE_MS) text += ", silent for " + age(now_ms - heard_ms);
    if (isFull()) text += ", no memory for more";
    if (has_other_formats) text += ", without layers of another knot interval or limits";
    return text;
  }

  private static String age(long ms) {
    return ms < 10_000 ? String.format("%.1f s", ms / 1000.0) : ms / 1000 + " s";
  }

  private static LayerId id(layer_epoch_t layer) {
    return new LayerId(layer.name, layer.origin);
  }

  private LayerControl control(LayerId id) {
    return controls.getOrDefault(id, LayerControl.NONE);
  }

  private boolean isFull() {
    return layers.values().stream().mapToInt(LayerCopy::numTilesKept).sum() >= MAX_TILES;
  }

  // The robot has begun another map.
  private void forgetReplaced(LayerId speaker, long now_ms) {
    layers.entrySet().removeIf(entry -> {
      LayerId id = entry.getKey();
      boolean is_replaced = id.name.equals(speaker.name) && id.origin != speaker.origin
          && now_ms - entry.getValue().spokenForMs() > FORGET_AFTER_MS;
      begins_anew |= is_replaced;
      return is_replaced;
    });
  }

  // The layers that yield count as one that is not sure.
  private short[] mergedPoints(Node tile) {
    List<short[]> parts = new ArrayList<>();
    List<short[]> yielding = new ArrayList<>();
    layers.forEach((id, layer) -> {
      LayerControl control = control(id);
      if (!control.isSummed()) return;
      short[] points =
          TileRows.shifted(layer::points, tile, control.shift_i(), control.shift_j());
      if (points != null) (control.yields() ? yielding : parts).add(points);
    });
    int min = format.min_control_point;
    int max = format.max_control_point;
    if (!yielding.isEmpty()) parts.add(sum(yielding, min * 4 / 5, max * 4 / 5));
    if (parts.size() <= 1) return parts.isEmpty() ? null : parts.get(0);
    return sum(parts, min, max);
  }

  // 1 where layers that know the place add up to 0.
  private static short[] sum(List<short[]> parts, int min, int max) {
    short[] merged = new short[TileCode.SIDE * TileCode.SIDE];
    for (int k = 0; k < merged.length; ++k) {
      int sum = 0;
      boolean is_known = false;
      for (short[] part : parts) {
        sum += part[k];
        is_known |= part[k] != 0;
      }
      sum = Math.max(min, Math.min(sum, max));
      merged[k] = (short) (is_known && sum == 0 ? 1 : sum);
    }
    return merged;
  }
}
