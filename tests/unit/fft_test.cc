#include "lib/matching/fft.h"

#include <gtest/gtest.h>

#include <complex>
#include <numbers>
#include <random>

namespace splinemap::fft_test {

ComplexGrid RandomGrid(int width, int height) {
  std::mt19937_64 random(1);
  std::normal_distribution<float> normal;
  ComplexGrid grid(width, height);
  for (std::complex<float>& cell : grid.cells) {
    const float real = normal(random);
    cell = {real, normal(random)};
  }
  return grid;
}

// By its definition.
std::complex<double> TransformAt(const ComplexGrid& grid, int u, int v) {
  std::complex<double> sum;
  for (int y = 0; y < grid.height; ++y) {
    for (int x = 0; x < grid.width; ++x) {
      const double turns = double{1} * u * x / grid.width + double{1} * v * y / grid.height;
      const size_t k = size_t{1} * y * grid.width + x;
      sum += std::complex<double>(grid.cells[k]) * std::polar(1.0, -2 * std::numbers::pi * turns);
    }
  }
  return sum;
}

TEST(GridFftTest, IsTheFourierTransform) {
  for (const auto& [width, height] : {std::pair(32, 40), {50, 32}, {64, 32}}) {
    const ComplexGrid grid = RandomGrid(width, height);
    ComplexGrid transformed = grid;
    GridFft().Forward(transformed);
    for (int v = 0; v < height; ++v) {
      for (int u = 0; u < width; ++u) {
        const std::complex<double> expected = TransformAt(grid, u, v);
        const size_t k = size_t{1} * v * width + u;
        EXPECT_NEAR(std::abs(std::complex<double>(transformed.cells[k]) - expected), 0, 1e-3);
      }
    }
  }
}

TEST(GridFftTest, InverseTakesItBack) {
  const ComplexGrid grid = RandomGrid(80, 64);
  ComplexGrid there_and_back = grid;
  GridFft fft;
  fft.Forward(there_and_back);
  fft.Inverse(there_and_back);
  for (size_t k = 0; k < grid.cells.size(); ++k) {
    EXPECT_NEAR(std::abs(there_and_back.cells[k] / (80.0F * 64) - grid.cells[k]), 0, 1e-5);
  }
}

TEST(GridFftTest, SizesAreTheLeastThatFit) {
  EXPECT_EQ(GridFft::SizeFor(1), 32);
  EXPECT_EQ(GridFft::SizeFor(33), 40);
  EXPECT_EQ(GridFft::SizeFor(40), 40);
  EXPECT_EQ(GridFft::SizeFor(51), 64);
  EXPECT_EQ(GridFft::SizeFor(385), 400);
}

}  // namespace splinemap::fft_test
