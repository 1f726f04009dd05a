#pragma once

#include <complex>
#include <cstddef>
#include <unsupported/Eigen/FFT>
#include <vector>

namespace splinemap {

// Complex numbers on a grid, rows of `width`.
struct ComplexGrid {
  ComplexGrid(int width_cells, int height_cells)
      : width(width_cells), height(height_cells), cells(size_t{1} * width_cells * height_cells) {}

  int width;
  int height;
  std::vector<std::complex<float>> cells;
};

// The discrete Fourier transform of grids. Keeps its memory from call to call. Thread-compatible.
class GridFft {
 public:
  GridFft() { fft_.SetFlag(Eigen::FFT<float>::Unscaled); }

  // The least size of `cells` or more that is fast: a product of 2s and 5s, from 32 on.
  static int SizeFor(int cells);

  // In place. Inverse() is not scaled: after both, all is width * height times what it was.
  void Forward(ComplexGrid& grid);
  void Inverse(ComplexGrid& grid);

 private:
  template <typename F>
  void TransformLines(ComplexGrid& grid, F transform);

  Eigen::FFT<float> fft_;
  std::vector<std::complex<float>> from_;
  std::vector<std::complex<float>> to_;
};

}  // namespace splinemap
