package splinemap.spy;

import com.github.luben.zstd.Zstd;
import java.nio.ByteBuffer;
import java.nio.ByteOrder;

/** The content and the checksums of tiles, as they are on the bus. */
final class TileCodec {
  static final int SIDE = 32;
  static final int BYTES = 2 * SIDE * SIDE;

  /** The control points of a zstd frame. IllegalArgumentException where it is not of a tile. */
  static short[] decode(byte[] content) {
    byte[] bytes = new byte[BYTES];
    if (Zstd.decompress(bytes, content) != BYTES) throw new IllegalArgumentException("no tile");
    short[] points = new short[SIDE * SIDE];
    ByteBuffer.wrap(bytes).order(ByteOrder.LITTLE_ENDIAN).asShortBuffer().get(points);
    return points;
  }

  /** The sum point by point, modulo 2^16. */
  static short[] sum(short[] base, short[] difference) {
    short[] sum = new short[base.length];
    for (int k = 0; k < sum.length; ++k) sum[k] = (short) (base[k] + difference[k]);
    return sum;
  }

  /** XXH3 with 64 bits and the seed ty << 32 | tx; the case of 2,048 bytes, two blocks. */
  static long checksum(Node tile, short[] points) {
    ByteBuffer bytes = ByteBuffer.allocate(BYTES).order(ByteOrder.LITTLE_ENDIAN);
    bytes.asShortBuffer().put(points);
    ByteBuffer secret = seededSecret((long) tile.y() << 32 | tile.x() & 0xffffffffL);
    long[] sums = {PRIME32_3, PRIME64_1, PRIME64_2, PRIME64_3,
                   PRIME64_4, PRIME32_2, PRIME64_5, PRIME32_1};
    for (int stripe = 0; stripe < BLOCK / STRIPE; ++stripe) {
      addStripe(sums, bytes, STRIPE * stripe, secret, 8 * stripe);
    }
    for (int k = 0; k < sums.length; ++k) {
      long key = secret.getLong(SECRET - STRIPE + 8 * k);
      sums[k] = (sums[k] ^ sums[k] >>> 47 ^ key) * PRIME32_1;
    }
    for (int stripe = 0; stripe < BLOCK / STRIPE - 1; ++stripe) {
      addStripe(sums, bytes, BLOCK + STRIPE * stripe, secret, 8 * stripe);
    }
    addStripe(sums, bytes, BYTES - STRIPE, secret, SECRET - STRIPE - 7);
    long hash = BYTES * PRIME64_1;
    for (int k = 0; k < sums.length; k += 2) {
      hash += foldedProduct(sums[k] ^ secret.getLong(11 + 8 * k),
                            sums[k + 1] ^ secret.getLong(11 + 8 * k + 8));
    }
    hash = (hash ^ hash >>> 37) * 0x165667919E3779F9L;
    return hash ^ hash >>> 32;
  }

  private static void addStripe(long[] sums, ByteBuffer bytes, int at, ByteBuffer secret, int key) {
    for (int k = 0; k < sums.length; ++k) {
      long value = bytes.getLong(at + 8 * k);
      long mixed = value ^ secret.getLong(key + 8 * k);
      sums[k ^ 1] += value;
      sums[k] += (mixed & 0xffffffffL) * (mixed >>> 32);
    }
  }

  private static ByteBuffer seededSecret(long seed) {
    ByteBuffer secret = ByteBuffer.allocate(SECRET).order(ByteOrder.LITTLE_ENDIAN);
    for (int k = 0; k < SECRET_WORDS.length; k += 2) {
      secret.putLong(SECRET_WORDS[k] + seed).putLong(SECRET_WORDS[k + 1] - seed);
    }
    return secret;
  }

  // XOR of the two halves of the product of unsigned numbers.
  private static long foldedProduct(long a, long b) {
    long high = Math.multiplyHigh(a, b) + (a >> 63 & b) + (b >> 63 & a);
    return a * b ^ high;
  }

  private static final int BLOCK = 1024;
  private static final int STRIPE = 64;
  private static final int SECRET = 192;
  private static final long PRIME32_1 = 0x9E3779B1L;
  private static final long PRIME32_2 = 0x85EBCA77L;
  private static final long PRIME32_3 = 0xC2B2AE3DL;
  private static final long PRIME64_1 = 0x9E3779B185EBCA87L;
  private static final long PRIME64_2 = 0xC2B2AE3D27D4EB4FL;
  private static final long PRIME64_3 = 0x165667B19E3779F9L;
  private static final long PRIME64_4 = 0x85EBCA77C2B2AE63L;
  private static final long PRIME64_5 = 0x27D4EB2F165667C5L;
  // XXH3's default secret, little-endian.
  private static final long[] SECRET_WORDS = {
    0xbe4ba423396cfeb8L, 0x1cad21f72c81017cL, 0xdb979083e96dd4deL, 0x1f67b3b7a4a44072L,
    0x78e5c0cc4ee679cbL, 0x2172ffcc7dd05a82L, 0x8e2443f7744608b8L, 0x4c263a81e69035e0L,
    0xcb00c391bb52283cL, 0xa32e531b8b65d088L, 0x4ef90da297486471L, 0xd8acdea946ef1938L,
    0x3f349ce33f76faa8L, 0x1d4f0bc7c7bbdcf9L, 0x3159b4cd4be0518aL, 0x647378d9c97e9fc8L,
    0xc3ebd33483acc5eaL, 0xeb6313faffa081c5L, 0x49daf0b751dd0d17L, 0x9e68d429265516d3L,
    0xfca1477d58be162bL, 0xce31d07ad1b8f88fL, 0x280416958f3acb45L, 0x7e404bbbcafbd7afL
  };

  private TileCodec() {}
}
