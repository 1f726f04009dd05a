package splinemap.spy;

import java.util.Comparator;
import splinemap.layer_ref_t;
import splinemap.layer_settings_t;

/** What people have set about one layer; layer_settings_t describes the fields. */
record LayerSettings(boolean muted, boolean low_weight, int shift_i, int shift_j, long counter,
                     long writer, long removed_up_to) {
  static final LayerSettings NONE = new LayerSettings(false, false, 0, 0, 0, 0, 0);
  private static final int MAX_SHIFT = 1 << 26;  // knots, each way
  private static final long MAX_COUNT = 1L << 61;

  // All fields are compared, so that two settings of one counter and writer have an order, too.
  private static final Comparator<LayerSettings> RANK =
      Comparator.comparing(LayerSettings::counter, Long::compareUnsigned)
          .thenComparing(LayerSettings::writer, Long::compareUnsigned)
          .thenComparing(LayerSettings::muted)
          .thenComparing(LayerSettings::low_weight)
          .thenComparing(LayerSettings::shift_i)
          .thenComparing(LayerSettings::shift_j);

  static LayerSettings of(layer_settings_t message) {
    return new LayerSettings(message.muted, message.low_weight, message.shift_i, message.shift_j,
                             message.counter, message.writer, message.removed_up_to);
  }

  /** Whether a message may say so. */
  boolean isValid() {
    return shift_i >= -MAX_SHIFT && shift_i <= MAX_SHIFT && shift_j >= -MAX_SHIFT
        && shift_j <= MAX_SHIFT && Long.compareUnsigned(counter, MAX_COUNT) <= 0
        && Long.compareUnsigned(removed_up_to, MAX_COUNT) <= 0;
  }

  /** The settings that result from two of one layer. Commutative, associative, idempotent. */
  LayerSettings merge(LayerSettings other) {
    LayerSettings last = RANK.compare(this, other) < 0 ? other : this;
    long removed = Long.compareUnsigned(removed_up_to, other.removed_up_to) < 0
        ? other.removed_up_to : removed_up_to;
    return new LayerSettings(last.muted, last.low_weight, last.shift_i, last.shift_j, last.counter,
                             last.writer, removed);
  }

  boolean isRemoved(layer_ref_t session) {
    return Long.compareUnsigned(session.session_number, removed_up_to) <= 0;
  }

  boolean isSummed() {
    return !muted;
  }
}
