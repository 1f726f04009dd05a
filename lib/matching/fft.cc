#include "lib/matching/fft.h"

#include <algorithm>

namespace splinemap {

int GridFft::SizeFor(int cells) {
  const auto is_fast = [](int size) {
    while (size % 2 == 0) size /= 2;
    while (size % 5 == 0) size /= 5;
    return size == 1;
  };
  int size = std::max(cells, 32);
  while (!is_fast(size)) ++size;
  return size;
}

// All rows, then all columns, some of them at once: what lies side by side is read together.
template <typename F>
void GridFft::TransformLines(ComplexGrid& grid, F transform) {
  constexpr int kAtOnce = 16;
  const size_t width = grid.width;
  const size_t height = grid.height;
  to_.resize(std::max(width, height));
  for (size_t y = 0; y < height; ++y) {
    const auto row = grid.cells.begin() + static_cast<ptrdiff_t>(y * width);
    transform(to_.data(), &*row, grid.width);
    std::copy_n(to_.begin(), width, row);
  }
  from_.resize(kAtOnce * height);
  for (size_t first = 0; first < width; first += kAtOnce) {
    const size_t columns = std::min<size_t>(kAtOnce, width - first);
    for (size_t y = 0; y < height; ++y) {
      for (size_t k = 0; k < columns; ++k)
        from_[k * height + y] = grid.cells[y * width + first + k];
    }
    for (size_t k = 0; k < columns; ++k) {
      transform(to_.data(), &from_[k * height], grid.height);
      std::copy_n(to_.begin(), height, from_.begin() + static_cast<ptrdiff_t>(k * height));
    }
    for (size_t y = 0; y < height; ++y) {
      for (size_t k = 0; k < columns; ++k)
        grid.cells[y * width + first + k] = from_[k * height + y];
    }
  }
}

void GridFft::Forward(ComplexGrid& grid) {
  TransformLines(grid, [this](auto* to, const auto* from, int n) { fft_.fwd(to, from, n); });
}

void GridFft::Inverse(ComplexGrid& grid) {
  TransformLines(grid, [this](auto* to, const auto* from, int n) { fft_.inv(to, from, n); });
}

}  // namespace splinemap
