#pragma once

#include <algorithm>
#include <cstddef>
#include <vector>

namespace splinemap {

// Complex numbers on a grid, rows of `width`.
struct ComplexGrid {
  ComplexGrid(int width_cells, int height_cells)
      : width(width_cells),
        height(height_cells),
        re(size_t{1} * width_cells * height_cells),
        im(re.size()) {}

  void Clear() {
    std::fill(re.begin(), re.end(), 0.0F);
    std::fill(im.begin(), im.end(), 0.0F);
  }

  int width;
  int height;
  std::vector<float> re;
  std::vector<float> im;
};

// The discrete Fourier transform of grids of one size. Keeps its memory from call to call.
// Thread-compatible.
class GridFft {
 public:
  // Requires sizes that SizeFor() gives.
  GridFft(int width, int height);

  // The least size of `cells` or more that is transformed: 2^n or 3 * 2^n, from 32 on.
  static int SizeFor(int cells);

  // In place. Inverse() is not scaled: after both, all is width * height times what it was.
  void Forward(ComplexGrid& grid);
  void Inverse(ComplexGrid& grid);

 private:
  // So many rows or columns are transformed side by side.
  static constexpr int kLanes = 16;

  // Of one length.
  struct Plan {
    explicit Plan(int length);

    int size;
    std::vector<int> radices;
    std::vector<float> cosines;  // of -2 pi k / size
    std::vector<float> sines;
  };
  // `kLanes` sequences, element k of all of them side by side.
  struct Strip {
    std::vector<float> re;
    std::vector<float> im;
  };

  void Transform(const Plan& plan);
  void TransformRows(ComplexGrid& grid);
  void TransformColumns(ComplexGrid& grid);

  Plan row_plan_;
  Plan column_plan_;
  Strip strip_;
  Strip other_;
};

}  // namespace splinemap
