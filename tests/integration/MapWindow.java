import java.awt.Rectangle;
import java.awt.Robot;
import java.awt.image.BufferedImage;
import java.io.File;
import javax.imageio.ImageIO;

/**
 * MapWindow X Y WIDTH HEIGHT MAP.png: whether the window there on the screen shows, within 10 s,
 * what `splinemap render` drew.
 */
final class MapWindow {
  private static final int UNKNOWN_RGB = 0xb0becd;
  private static final double MIN_AGREEMENT = 0.998;

  public static void main(String[] arguments) throws Exception {
    int[] n = new int[4];
    for (int k = 0; k < 4; ++k) n[k] = Integer.parseInt(arguments[k]);
    BufferedImage rendered = known(ImageIO.read(new File(arguments[4])));
    Robot robot = new Robot();
    double agreement = 0;
    for (int attempt = 0; attempt < 20 && agreement < MIN_AGREEMENT; ++attempt) {
      Thread.sleep(500);
      BufferedImage shown =
          known(map(robot.createScreenCapture(new Rectangle(n[0], n[1], n[2], n[3]))));
      agreement = Math.min(agreement(shown, rendered), agreement(rendered, shown));
    }
    System.out.printf("%.2f %% of the map is shown%n", 100 * agreement);
    System.exit(agreement >= MIN_AGREEMENT ? 0 : 1);
  }

  // The part above the line of text. Around the map there is a margin of unknown pixels.
  private static BufferedImage map(BufferedImage window) {
    int height = 0;
    while (height < window.getHeight() && !isKnown(window, 0, height)) ++height;
    return window.getSubimage(0, 0, window.getWidth(), Math.max(1, height));
  }

  // The part with known pixels.
  private static BufferedImage known(BufferedImage image) {
    int left = image.getWidth();
    int right = 0;
    int top = image.getHeight();
    int bottom = 0;
    for (int y = 0; y < image.getHeight(); ++y) {
      for (int x = 0; x < image.getWidth(); ++x) {
        if (!isKnown(image, x, y)) continue;
        left = Math.min(left, x);
        right = Math.max(right, x);
        top = Math.min(top, y);
        bottom = Math.max(bottom, y);
      }
    }
    if (left > right) return image;
    return image.getSubimage(left, top, right - left + 1, bottom - top + 1);
  }

  // The share of pixels of one image that the other has there or beside.
  private static double agreement(BufferedImage one, BufferedImage other) {
    int agreeing = 0;
    for (int y = 0; y < one.getHeight(); ++y) {
      for (int x = 0; x < one.getWidth(); ++x) {
        int other_x = (int) ((x + 0.5) / one.getWidth() * other.getWidth());
        int other_y = (int) ((y + 0.5) / one.getHeight() * other.getHeight());
        agreeing += hasNear(other, other_x, other_y, kind(one, x, y)) ? 1 : 0;
      }
    }
    return agreeing / (double) (one.getWidth() * one.getHeight());
  }

  private static boolean hasNear(BufferedImage image, int x, int y, int kind) {
    for (int v = Math.max(0, y - 1); v <= Math.min(y + 1, image.getHeight() - 1); ++v) {
      for (int u = Math.max(0, x - 1); u <= Math.min(x + 1, image.getWidth() - 1); ++u) {
        if (kind(image, u, v) == kind) return true;
      }
    }
    return false;
  }

  private static boolean isKnown(BufferedImage image, int x, int y) {
    return (image.getRGB(x, y) & 0xffffff) != UNKNOWN_RGB;
  }

  // 0: unknown, 1: rather occupied, 2: rather free.
  private static int kind(BufferedImage image, int x, int y) {
    if (!isKnown(image, x, y)) return 0;
    return (image.getRGB(x, y) & 0xff) < 128 ? 1 : 2;
  }
}
