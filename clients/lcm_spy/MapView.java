package splinemap.spy;

import java.awt.Dimension;
import java.awt.Graphics;
import java.awt.Point;
import java.awt.event.MouseAdapter;
import java.awt.event.MouseEvent;
import java.awt.event.MouseWheelEvent;
import java.util.function.Consumer;
import javax.swing.JComponent;

/**
 * Shows a map, fitted to the window until someone zooms by the wheel or drags. A double click fits
 * it again. A callback gets a text about the place under the cursor.
 */
final class MapView extends JComponent {
  private static final double ZOOM_PER_NOTCH = 1.25;
  private static final double MIN_KNOTS_PER_PIXEL = 1.0 / 64;
  private static final double MAX_KNOTS = 1 << 28;  // no tile is beyond
  private static final int MARGIN_PX = 10;

  private final MapFollower map;
  private final Consumer<String> tell;
  private boolean fits = true;
  private double pixel_m = 0.05;
  private double centre_x_m;
  private double centre_y_m;
  private Point cursor;

  MapView(MapFollower map, Consumer<String> tell) {
    this.map = map;
    this.tell = tell;
    setPreferredSize(new Dimension(700, 500));
    MouseAdapter mouse = new Mouse();
    addMouseListener(mouse);
    addMouseMotionListener(mouse);
    addMouseWheelListener(mouse);
  }

  /** Call it when the map has changed. */
  void refresh() {
    repaint();
    tellCursor();
  }

  @Override
  protected void paintComponent(Graphics graphics) {
    if (getWidth() <= 0 || getHeight() <= 0) return;
    if (fits) fit();
    graphics.drawImage(
        MapPicture.draw(map, xM(0), yM(0), pixel_m, getWidth(), getHeight()), 0, 0, null);
  }

  private void fit() {
    KnotBox box = map.touched();
    double knot_m = map.knotIntervalM();
    if (box.isEmpty()) return;
    double width_m = (box.max_i() - (double) box.min_i() + 1) * knot_m;
    double height_m = (box.max_j() - (double) box.min_j() + 1) * knot_m;
    moveTo((box.min_i() + (double) box.max_i()) / 2 * knot_m,
           (box.min_j() + (double) box.max_j()) / 2 * knot_m);
    setPixel(Math.max(width_m / Math.max(1, getWidth() - 2 * MARGIN_PX),
                      height_m / Math.max(1, getHeight() - 2 * MARGIN_PX)));
  }

  private void setPixel(double pixel_m) {
    double knot_m = map.knotIntervalM();
    this.pixel_m = Math.max(MIN_KNOTS_PER_PIXEL * knot_m,
                            Math.min(pixel_m, MapPicture.MAX_KNOTS_PER_PIXEL * knot_m));
  }

  private void moveTo(double x_m, double y_m) {
    double max_m = MAX_KNOTS * map.knotIntervalM();
    centre_x_m = Math.max(-max_m, Math.min(x_m, max_m));
    centre_y_m = Math.max(-max_m, Math.min(y_m, max_m));
  }

  private double xM(double column) {
    return centre_x_m + (column - getWidth() / 2.0) * pixel_m;
  }

  private double yM(double row) {
    return centre_y_m - (row - getHeight() / 2.0) * pixel_m;
  }

  private void tellCursor() {
    if (cursor == null) {
      tell.accept("");
      return;
    }
    double x_m = xM(cursor.x + 0.5);
    double y_m = yM(cursor.y + 0.5);
    double log_odds = map.logOdds(x_m, y_m);
    String value = Double.isNaN(log_odds)
        ? "unknown"
        : String.format("log-odds %.2f, probability %.3f", log_odds,
                        MapPicture.probability(log_odds));
    tell.accept(String.format("x %.2f m, y %.2f m: %s", x_m, y_m, value));
  }

  private final class Mouse extends MouseAdapter {
    private Point grabbed;

    @Override
    public void mousePressed(MouseEvent event) {
      grabbed = event.getPoint();
    }

    @Override
    public void mouseDragged(MouseEvent event) {
      fits = false;
      moveTo(centre_x_m - (event.getX() - grabbed.x) * pixel_m,
             centre_y_m + (event.getY() - grabbed.y) * pixel_m);
      grabbed = event.getPoint();
      moveCursor(event.getPoint());
    }

    @Override
    public void mouseWheelMoved(MouseWheelEvent event) {
      fits = false;
      // The place under the cursor stays there.
      double x_m = xM(event.getX());
      double y_m = yM(event.getY());
      setPixel(pixel_m * Math.pow(ZOOM_PER_NOTCH, event.getPreciseWheelRotation()));
      moveTo(centre_x_m + x_m - xM(event.getX()), centre_y_m + y_m - yM(event.getY()));
      moveCursor(event.getPoint());
    }

    @Override
    public void mouseClicked(MouseEvent event) {
      if (event.getClickCount() != 2) return;
      fits = true;
      refresh();
    }

    @Override
    public void mouseMoved(MouseEvent event) {
      cursor = event.getPoint();
      tellCursor();
    }

    @Override
    public void mouseExited(MouseEvent event) {
      cursor = null;
      tellCursor();
    }

    private void moveCursor(Point point) {
      cursor = point;
      refresh();
    }
  }
}
