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
  for (float& x : grid.re) x = normal(random);
  for (float& x : grid.im) x = normal(random);
  return grid;
}

// By its definition.
std::complex<double> TransformAt(const ComplexGrid& grid, int u, int v) {
  std::complex<double> sum;
  for (int y = 0; y < grid.height; ++y) {
    for (int x = 0; x < grid.width; ++x) {
      const double turns = double{1} * u * x / grid.width + double{1} * v * y / grid.height;
      const size_t k = size_t{1} * y * grid.width + x;
      sum += std::complex<double>(grid.re[k], grid.im[k]) *
             std::polar(1.0, -2 * std::numbers::pi * turns);
    }
  }
  return sum;
}

TEST(GridFftTest, IsTheFourierTransform) {
  for (const auto& [width, height] : {std::pair(32, 48), {48, 32}, {64, 32}}) {
    const ComplexGrid grid = RandomGrid(width, height);
    ComplexGrid transformed = grid;
    GridFft(width, height).Forward(transformed);
    for (int v = 0; v < height; ++v) {
      for (int u = 0; u < width; ++u) {
        const std::complex<double> expected = TransformAt(grid, u, v);
        const size_t k = size_t{1} * v * width + u;
        EXPECT_NEAR(transformed.re[k], expected.real(), 1e-3);
        EXPECT_NEAR(transformed.im[k], expected.imag(), 1e-3);
      }
    }
  }
}

TEST(GridFftTest, InverseTakesItBack) {
  const ComplexGrid grid = RandomGrid(96, 64);
  ComplexGrid there_and_back = grid;
  GridFft fft(96, 64);
  fft.Forward(there_and_back);
  fft.Inverse(there_and_back);
  for (size_t k = 0; k < grid.re.size(); ++k) {
    EXPECT_NEAR(there_and_back.re[k] / (96 * 64), grid.re[k], 1e-5);
    EXPECT_NEAR(there_and_back.im[k] / (96 * 64), grid.im[k], 1e-5);
  }
}

TEST(GridFftTest, SizesAreTheLeastThatFit) {
  EXPECT_EQ(GridFft::SizeFor(1), 32);
  EXPECT_EQ(GridFft::SizeFor(33), 48);
  EXPECT_EQ(GridFft::SizeFor(48), 48);
  EXPECT_EQ(GridFft::SizeFor(49), 64);
  EXPECT_EQ(GridFft::SizeFor(385), 512);
}

}  // namespace splinemap::fft_test
