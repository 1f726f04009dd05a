package splinemap.spy;

import java.util.Comparator;
import splinemap.layer_control_t;
import splinemap.layer_epoch_t;

/** What people have decided about a layer; layer_control_t has the words for it. */
record LayerControl(boolean muted, boolean yields, int shift_i, int shift_j, double x_m, double y_m,
                    double yaw_rad, long counter, long writer, long removed_up_to) {
  static final LayerControl NONE = new LayerControl(false, false, 0, 0, 0, 0, 0, 0, 0, 0);
  private static final int MAX_SHIFT = 1 << 26;  // knots, each way
  private static final long MAX_COUNT = 1L << 61;

  // All fields, so that there is an order even between two records of one writer's counter.
  private static final Comparator<LayerControl> RANK =
      Comparator.comparing(LayerControl::counter, Long::compareUnsigned)
          .thenComparing(LayerControl::writer, Long::compareUnsigned)
          .thenComparing(LayerControl::muted)
          .thenComparing(LayerControl::yields)
          .thenComparing(LayerControl::shift_i)
          .thenComparing(LayerControl::shift_j)
          .thenComparing(LayerControl::x_m)
          .thenComparing(LayerControl::y_m)
          .thenComparing(LayerControl::yaw_rad);

  static LayerControl of(layer_control_t message) {
    return new LayerControl(message.muted, message.yields, message.shift_i, message.shift_j,
                            message.x_m, message.y_m, message.yaw_rad, message.counter,
                            message.writer, message.removed_up_to);
  }

  boolean isValid() {
    return shift_i >= -MAX_SHIFT && shift_i <= MAX_SHIFT && shift_j >= -MAX_SHIFT
        && shift_j <= MAX_SHIFT && Double.isFinite(x_m) && Double.isFinite(y_m)
        && Double.isFinite(yaw_rad) && Long.compareUnsigned(counter, MAX_COUNT) <= 0
        && Long.compareUnsigned(removed_up_to, MAX_COUNT) <= 0;
  }

  /** The record that results from two of one layer, in whatever order they come. */
  LayerControl merge(LayerControl other) {
    LayerControl last = RANK.compare(this, other) < 0 ? other : this;
    long removed = Long.compareUnsigned(removed_up_to, other.removed_up_to) < 0
        ? other.removed_up_to : removed_up_to;
    return new LayerControl(last.muted, last.yields, last.shift_i, last.shift_j, last.x_m, last.y_m,
                            last.yaw_rad, last.counter, last.writer, removed);
  }

  boolean isRemoved(layer_epoch_t life) {
    return Long.compareUnsigned(life.incarnation, removed_up_to) <= 0;
  }

  /** A rigid transform cannot be applied yet: who has one is left out. */
  boolean isSummed() {
    return !muted && x_m == 0 && y_m == 0 && yaw_rad == 0;
  }
}
