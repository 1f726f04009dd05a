package splinemap.spy;

/** Control points [min_i, max_i] x [min_j, max_j]. */
record KnotBox(int min_i, int max_i, int min_j, int max_j) {
  static final KnotBox EMPTY =
      new KnotBox(Integer.MAX_VALUE, Integer.MIN_VALUE, Integer.MAX_VALUE, Integer.MIN_VALUE);

  boolean isEmpty() {
    return min_i > max_i;
  }

  /** The least box that also has the known control points of a tile. */
  KnotBox with(Node tile, short[] points) {
    int left = min_i;
    int right = max_i;
    int bottom = min_j;
    int top = max_j;
    for (int k = 0; k < points.length; ++k) {
      if (points[k] == 0) continue;
      int i = TileCodec.SIDE * tile.x() + k % TileCodec.SIDE;
      int j = TileCodec.SIDE * tile.y() + k / TileCodec.SIDE;
      left = Math.min(left, i);
      right = Math.max(right, i);
      bottom = Math.min(bottom, j);
      top = Math.max(top, j);
    }
    return new KnotBox(left, right, bottom, top);
  }
}
