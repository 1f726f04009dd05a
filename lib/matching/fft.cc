#include "lib/matching/fft.h"

#include <algorithm>
#include <cstddef>
#include <numbers>
#include <utility>

#include "lib/geometry/angle.h"

namespace splinemap {
namespace {

struct Complex {
  float re;
  float im;
};

// One stage of Stockham's transform: of `length` elements `stride` apart, by butterflies of
// kRadix. Each element is `stride` numbers side by side, that are transformed alike.
struct Stage {
  int length;
  size_t stride;
  const float* from_re;
  const float* from_im;
  float* to_re;
  float* to_im;
};

void Butterflies2(const Stage& stage, const Complex& w, const float* __restrict re,
                  const float* __restrict im, float* __restrict to_re, float* __restrict to_im) {
  const size_t apart = stage.stride * (stage.length / 2);
  const size_t stride = stage.stride;
  for (size_t q = 0; q < stride; ++q) {
    const float a_re = re[q];
    const float a_im = im[q];
    const float b_re = re[q + apart];
    const float b_im = im[q + apart];
    to_re[q] = a_re + b_re;
    to_im[q] = a_im + b_im;
    const float d_re = a_re - b_re;
    const float d_im = a_im - b_im;
    to_re[q + stride] = d_re * w.re - d_im * w.im;
    to_im[q + stride] = d_re * w.im + d_im * w.re;
  }
}

void Butterflies3(const Stage& stage, const Complex& w1, const Complex& w2,
                  const float* __restrict re, const float* im, float* __restrict to_re,
                  float* __restrict to_im) {
  const size_t apart = stage.stride * (stage.length / 3);
  const size_t stride = stage.stride;
  constexpr auto kHalfSqrt3 = static_cast<float>(std::numbers::sqrt3 / 2);
  for (size_t q = 0; q < stride; ++q) {
    const float sum_re = re[q + apart] + re[q + 2 * apart];
    const float sum_im = im[q + apart] + im[q + 2 * apart];
    const float difference_re = kHalfSqrt3 * (re[q + apart] - re[q + 2 * apart]);
    const float difference_im = kHalfSqrt3 * (im[q + apart] - im[q + 2 * apart]);
    const float middle_re = re[q] - 0.5F * sum_re;
    const float middle_im = im[q] - 0.5F * sum_im;
    to_re[q] = re[q] + sum_re;
    to_im[q] = im[q] + sum_im;
    const float b_re = middle_re + difference_im;
    const float b_im = middle_im - difference_re;
    to_re[q + stride] = b_re * w1.re - b_im * w1.im;
    to_im[q + stride] = b_re * w1.im + b_im * w1.re;
    const float c_re = middle_re - difference_im;
    const float c_im = middle_im + difference_re;
    to_re[q + 2 * stride] = c_re * w2.re - c_im * w2.im;
    to_im[q + 2 * stride] = c_re * w2.im + c_im * w2.re;
  }
}

void Butterflies4(const Stage& stage, const Complex& w1, const Complex& w2, const Complex& w3,
                  const float* __restrict re, const float* __restrict im, float* __restrict to_re,
                  float* __restrict to_im) {
  const size_t apart = stage.stride * (stage.length / 4);
  const size_t stride = stage.stride;
  for (size_t q = 0; q < stride; ++q) {
    const float even_sum_re = re[q] + re[q + 2 * apart];
    const float even_sum_im = im[q] + im[q + 2 * apart];
    const float even_difference_re = re[q] - re[q + 2 * apart];
    const float even_difference_im = im[q] - im[q + 2 * apart];
    const float odd_sum_re = re[q + apart] + re[q + 3 * apart];
    const float odd_sum_im = im[q + apart] + im[q + 3 * apart];
    const float odd_difference_re = re[q + apart] - re[q + 3 * apart];
    const float odd_difference_im = im[q + apart] - im[q + 3 * apart];
    to_re[q] = even_sum_re + odd_sum_re;
    to_im[q] = even_sum_im + odd_sum_im;
    const float b_re = even_difference_re + odd_difference_im;
    const float b_im = even_difference_im - odd_difference_re;
    to_re[q + stride] = b_re * w1.re - b_im * w1.im;
    to_im[q + stride] = b_re * w1.im + b_im * w1.re;
    const float c_re = even_sum_re - odd_sum_re;
    const float c_im = even_sum_im - odd_sum_im;
    to_re[q + 2 * stride] = c_re * w2.re - c_im * w2.im;
    to_im[q + 2 * stride] = c_re * w2.im + c_im * w2.re;
    const float d_re = even_difference_re - odd_difference_im;
    const float d_im = even_difference_im + odd_difference_re;
    to_re[q + 3 * stride] = d_re * w3.re - d_im * w3.im;
    to_im[q + 3 * stride] = d_re * w3.im + d_im * w3.re;
  }
}

}  // namespace

int GridFft::SizeFor(int cells) {
  int size = 2 * kLanes;
  while (size < cells) {
    if (size / 2 * 3 >= cells) return size / 2 * 3;
    size *= 2;
  }
  return size;
}

GridFft::Plan::Plan(int length) : size(length) {
  int rest = length;
  for (const int radix : {3, 4, 2}) {
    for (; rest % radix == 0; rest /= radix) radices.push_back(radix);
  }
  for (int k = 0; k < length; ++k) {
    const Eigen::Vector2d unit = UnitVector(-2 * std::numbers::pi * k / length);
    cosines.push_back(static_cast<float>(unit.x()));
    sines.push_back(static_cast<float>(unit.y()));
  }
}

GridFft::GridFft(int width, int height) : row_plan_(width), column_plan_(height) {
  for (Strip* strip : {&strip_, &other_}) {
    strip->re.resize(size_t{kLanes} * std::max(width, height));
    strip->im.resize(strip->re.size());
  }
}

void GridFft::Transform(const Plan& plan) {
  int length = plan.size;
  int step = 1;  // from one root of unity of `length` to the next
  for (const int radix : plan.radices) {
    const Stage stage{length,           size_t{kLanes} * step, strip_.re.data(),
                      strip_.im.data(), other_.re.data(),      other_.im.data()};
    for (int p = 0; p < length / radix; ++p) {
      const auto root = [&](int k) -> Complex {
        return {plan.cosines[k * p * step], plan.sines[k * p * step]};
      };
      const size_t from = stage.stride * p;
      const size_t to = stage.stride * p * radix;
      const float* const re = stage.from_re + from;
      const float* const im = stage.from_im + from;
      if (radix == 4) {
        Butterflies4(stage, root(1), root(2), root(3), re, im, stage.to_re + to, stage.to_im + to);
      } else if (radix == 3) {
        Butterflies3(stage, root(1), root(2), re, im, stage.to_re + to, stage.to_im + to);
      } else {
        Butterflies2(stage, root(1), re, im, stage.to_re + to, stage.to_im + to);
      }
    }
    std::swap(strip_, other_);
    length /= radix;
    step *= radix;
  }
}

void GridFft::TransformColumns(ComplexGrid& grid) {
  for (int x = 0; x < grid.width; x += kLanes) {
    for (int y = 0; y < grid.height; ++y) {
      const size_t from = size_t{1} * y * grid.width + x;
      std::copy_n(&grid.re[from], kLanes, &strip_.re[size_t{kLanes} * y]);
      std::copy_n(&grid.im[from], kLanes, &strip_.im[size_t{kLanes} * y]);
    }
    Transform(column_plan_);
    for (int y = 0; y < grid.height; ++y) {
      const size_t to = size_t{1} * y * grid.width + x;
      std::copy_n(&strip_.re[size_t{kLanes} * y], kLanes, &grid.re[to]);
      std::copy_n(&strip_.im[size_t{kLanes} * y], kLanes, &grid.im[to]);
    }
  }
}

void GridFft::TransformRows(ComplexGrid& grid) {
  for (int y = 0; y < grid.height; y += kLanes) {
    const size_t first = size_t{1} * y * grid.width;
    for (int lane = 0; lane < kLanes; ++lane) {
      const size_t row = first + size_t{1} * lane * grid.width;
      for (int x = 0; x < grid.width; ++x) {
        strip_.re[size_t{kLanes} * x + lane] = grid.re[row + x];
        strip_.im[size_t{kLanes} * x + lane] = grid.im[row + x];
      }
    }
    Transform(row_plan_);
    for (int lane = 0; lane < kLanes; ++lane) {
      const size_t row = first + size_t{1} * lane * grid.width;
      for (int x = 0; x < grid.width; ++x) {
        grid.re[row + x] = strip_.re[size_t{kLanes} * x + lane];
        grid.im[row + x] = strip_.im[size_t{kLanes} * x + lane];
      }
    }
  }
}

void GridFft::Forward(ComplexGrid& grid) {
  TransformRows(grid);
  TransformColumns(grid);
}

void GridFft::Inverse(ComplexGrid& grid) {
  // The conjugate of the transform of the conjugate.
  std::swap(grid.re, grid.im);
  Forward(grid);
  std::swap(grid.re, grid.im);
}

}  // namespace splinemap
