package splinemap.spy;

/** A square of 8^level x 8^level tiles; (0, tx, ty) is a tile. */
record Node(int level, int x, int y) {
  static final int MAX_LEVEL = 8;  // from there on nodes have x, y in {-1, 0}
  private static final int MAX_TILE = 1 << 23;

  /** Whether the protocol has such a node. */
  boolean isValid() {
    if (level < 0 || level > MAX_LEVEL) return false;
    if (level == 0) return Math.abs((long) x) <= MAX_TILE && Math.abs((long) y) <= MAX_TILE;
    int limit = 1 << (24 - 3 * level);
    return x >= -limit && x < limit && y >= -limit && y < limit;
  }

  Node parent() {
    return new Node(level + 1, x >> 3, y >> 3);
  }

  Node child(int k) {
    return new Node(level - 1, 8 * x + (k & 7), 8 * y + (k >> 3));
  }
}
