package splinemap.spy;

/** The surface of a map along a line of one y. Coordinates are in knot intervals. */
final class SurfaceRow {
  private final MapFollower map;
  private final int first_i;
  private final short[][] rows = new short[4][];  // of control points, from (first_i, first_j) on
  private int first_j = Integer.MIN_VALUE;
  private final double[] sums;  // of the columns of `rows`, weighted for y
  private short[] nearest;      // the one of `rows` that is nearest to y
  private final double[] weights = new double[4];

  /** For x in [min_x, max_x]. */
  SurfaceRow(MapFollower map, double min_x, double max_x) {
    this.map = map;
    first_i = (int) Math.floor(min_x) - 1;
    int num_knots = (int) Math.floor(max_x) + 3 - first_i;
    for (int row = 0; row < 4; ++row) rows[row] = new short[num_knots];
    sums = new double[num_knots];
  }

  void moveTo(double y) {
    int j = (int) Math.floor(y);
    if (first_j != j - 1) {
      first_j = j - 1;
      for (int row = 0; row < 4; ++row) {
        TileRows.copy(map::points, first_i, first_j + row, rows[row], 0, rows[row].length);
      }
    }
    basis(y - j);
    for (int k = 0; k < sums.length; ++k) {
      sums[k] = weights[0] * rows[0][k] + weights[1] * rows[1][k] + weights[2] * rows[2][k]
          + weights[3] * rows[3][k];
    }
    nearest = rows[y - j < 0.5 ? 1 : 2];
  }

  /** Log-odds; NaN where the control point nearest to the point is unknown. */
  double at(double x) {
    int i = (int) Math.floor(x);
    int k = i - 1 - first_i;
    if (nearest[x - i < 0.5 ? k + 1 : k + 2] == 0) return Double.NaN;
    basis(x - i);
    return (weights[0] * sums[k] + weights[1] * sums[k + 1] + weights[2] * sums[k + 2]
            + weights[3] * sums[k + 3]) / 256;
  }

  // The uniform cubic basis spline at phase t.
  private void basis(double t) {
    double u = 1 - t;
    weights[0] = u * u * u / 6;
    weights[1] = (3 * t * t * t - 6 * t * t + 4) / 6;
    weights[2] = (3 * u * u * u - 6 * u * u + 4) / 6;
    weights[3] = t * t * t / 6;
  }
}
