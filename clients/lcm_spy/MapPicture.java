package splinemap.spy;

import java.awt.image.BufferedImage;
import java.util.Arrays;

/** Draws the surface of a map: black is occupied, white is free, blue-grey is unknown. */
final class MapPicture {
  static final double MAX_KNOTS_PER_PIXEL = 16;  // coarser ones would take long to draw
  private static final int MAX_SAMPLES_PER_PIXEL = 4;  // each way
  private static final int UNKNOWN_RGB = 0xb0becd;
  private static final double SHADES_PER_LOG_ODDS = 64;
  private static final int[] SHADES_RGB = new int[(int) (2 * 8 * SHADES_PER_LOG_ODDS) + 1];

  static {
    for (int k = 0; k < SHADES_RGB.length; ++k) {
      double log_odds = (k - SHADES_RGB.length / 2) / SHADES_PER_LOG_ODDS;
      SHADES_RGB[k] = 0x010101 * (int) (255 - Math.round(254 * probability(log_odds)));
    }
  }

  static double probability(double log_odds) {
    return 1 / (1 + Math.exp(-log_odds));
  }

  /**
   * The pixels right and down of a corner. A pixel shows the surface at its centre. Pixels larger
   * than a knot interval show the most occupied of several places, so that no wall is lost.
   */
  static BufferedImage draw(MapFollower map, double left_m, double top_m, double pixel_m, int width,
                            int height) {
    BufferedImage image = new BufferedImage(width, height, BufferedImage.TYPE_INT_RGB);
    synchronized (map) {
      double pixel = pixel_m / map.knotIntervalM();
      int samples = (int) Math.max(1, Math.min(Math.ceil(pixel), MAX_SAMPLES_PER_PIXEL));
      double step = pixel / samples;
      double left = left_m / map.knotIntervalM() + step / 2;
      double top = top_m / map.knotIntervalM() - step / 2;
      SurfaceRow surface = new SurfaceRow(map, left, left + width * pixel);
      double[] log_odds = new double[width];
      for (int y = 0; y < height; ++y) {
        Arrays.fill(log_odds, Double.NaN);
        for (int row = y * samples; row < (y + 1) * samples; ++row) {
          surface.moveTo(top - row * step);
          for (int column = 0; column < width * samples; ++column) {
            double value = surface.at(left + column * step);
            int x = column / samples;
            if (!(value <= log_odds[x])) log_odds[x] = Double.isNaN(value) ? log_odds[x] : value;
          }
        }
        for (int x = 0; x < width; ++x) image.setRGB(x, y, rgb(log_odds[x]));
      }
    }
    return image;
  }

  private static int rgb(double log_odds) {
    if (Double.isNaN(log_odds)) return UNKNOWN_RGB;
    long k = Math.round(log_odds * SHADES_PER_LOG_ODDS) + SHADES_RGB.length / 2;
    return SHADES_RGB[(int) Math.max(0, Math.min(k, SHADES_RGB.length - 1))];
  }

  private MapPicture() {}
}
