package splinemap.spy;

import java.util.Arrays;
import java.util.HashSet;
import java.util.Set;
import java.util.function.Function;

/** Control points across the borders of tiles. */
final class TileRows {
  /** Copies control points (i, j), (i + 1, j) .. to [begin, end); 0 where there is no tile. */
  static void copy(Function<Node, short[]> tiles, int i, int j, short[] to, int begin, int end) {
    int side = TileCodec.SIDE;
    int ty = Math.floorDiv(j, side);
    while (begin < end) {
      int in_tile = Math.floorMod(i, side);
      int count = Math.min(side - in_tile, end - begin);
      short[] points = tiles.apply(new Node(0, Math.floorDiv(i, side), ty));
      if (points == null) {
        Arrays.fill(to, begin, begin + count, (short) 0);
      } else {
        System.arraycopy(points, Math.floorMod(j, side) * side + in_tile, to, begin, count);
      }
      begin += count;
      i += count;
    }
  }

  /** A tile of the map: control point (i, j) of the layer is at (i, j) + the shift. */
  static short[] shifted(Function<Node, short[]> layer, Node tile, int shift_i, int shift_j) {
    if (shift_i == 0 && shift_j == 0) return layer.apply(tile);
    int side = TileCodec.SIDE;
    short[] points = new short[side * side];
    for (int row = 0; row < side; ++row) {
      copy(layer, side * tile.x() - shift_i, side * tile.y() - shift_j + row, points, side * row,
           side * (row + 1));
    }
    for (short point : points) {
      if (point != 0) return points;
    }
    return null;
  }

  /** The tiles of the map, up to four, that overlap a shifted tile of a layer. */
  static Set<Node> keysOfShifted(Node tile, int shift_i, int shift_j) {
    int side = TileCodec.SIDE;
    int i = side * tile.x() + shift_i;
    int j = side * tile.y() + shift_j;
    Set<Node> keys = new HashSet<>();
    for (int v : new int[] {j, j + side - 1}) {
      for (int u : new int[] {i, i + side - 1}) {
        Node key = new Node(0, Math.floorDiv(u, side), Math.floorDiv(v, side));
        if (key.isValid()) keys.add(key);
      }
    }
    return keys;
  }

  private TileRows() {}
}
