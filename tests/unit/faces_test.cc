#include "lib/mapping/faces.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstddef>
#include <cstring>
#include <numbers>

namespace splinemap::faces_test {

constexpr double kRad = std::numbers::pi / 180;
constexpr double kKnotsPerM = 20;

PlacedBeam Beam(double bearing_deg, double range_m) {
  return {{0, 0}, {std::cos(bearing_deg * kRad), std::sin(bearing_deg * kRad)}, range_m, true};
}

std::vector<Face> Find(const std::vector<PlacedBeam>& beams) {
  FaceFinder finder(kKnotsPerM);
  const absl::Span<const Face> faces = finder.Find(beams);
  EXPECT_EQ(faces.size(), beams.size());
  return {faces.begin(), faces.end()};
}

// Of a wall at x = 1.
double RangeOfWall(double bearing_deg) { return 1 / std::cos(bearing_deg * kRad); }

TEST(FacesTest, AWallHasItsNormalAtEveryIncidence) {
  std::vector<PlacedBeam> beams;
  for (int deg = -75; deg <= 75; ++deg) beams.push_back(Beam(deg, RangeOfWall(deg)));
  const std::vector<Face> faces = Find(beams);
  for (size_t k = 0; k < faces.size(); ++k) {
    EXPECT_NEAR(faces[k].normal[0], 1, 1e-6) << k;
    EXPECT_NEAR(faces[k].normal[1], 0, 1e-6) << k;
    EXPECT_EQ(faces[k].weight, kFaceWeight) << k;
  }
  // The control points that lie so far before the face, along the beam.
  EXPECT_NEAR(faces[75].before_knots, 2, 1e-6);
  EXPECT_NEAR(faces[135].before_knots, 1 + 1 / std::cos(60 * kRad), 1e-6);
  EXPECT_EQ(faces[150].before_knots, faces[148].before_knots) << "not further than at 72 degrees";
}

TEST(FacesTest, ALoneHitFacesTheSensorAndWeighsMore) {
  const std::vector<Face> faces = Find({Beam(28, 3), Beam(29, 3), Beam(30, 1), Beam(31, 3)});
  EXPECT_NEAR(faces[2].normal[0], std::cos(30 * kRad), 1e-6);
  EXPECT_NEAR(faces[2].normal[1], std::sin(30 * kRad), 1e-6);
  EXPECT_EQ(faces[2].weight, kMostFaceWeight);
  EXPECT_EQ(faces[0].weight, kFaceWeight);
}

TEST(FacesTest, WhatIsHiddenOrAtTheEndOfAScanIsNotNarrow) {
  EXPECT_EQ(Find({Beam(29, 1), Beam(30, 3), Beam(31, 5)})[1].weight, kFaceWeight);
  EXPECT_EQ(Find({Beam(30, 1), Beam(31, 5)})[0].weight, kFaceWeight);
}

TEST(FacesTest, FacesEndWhereTheRangeJumps) {
  std::vector<PlacedBeam> beams;
  for (int deg = 0; deg < 20; ++deg)
    beams.push_back(Beam(deg, (deg < 10 ? 1 : 2) * RangeOfWall(deg)));
  for (const Face& face : Find(beams)) EXPECT_NEAR(face.normal[0], 1, 1e-6);
}

TEST(FacesTest, EveryKernelFindsTheFacesOfThePlainOne) {
  std::vector<PlacedBeam> beams;
  for (int deg = 0; deg < 203; ++deg) {
    beams.push_back(Beam(deg, 1 + 0.1 * (deg * deg % 7) * (deg % 40 / 20)));
    beams.back().hit = deg % 17 != 0;
  }
  FaceFinder plain(kKnotsPerM, ScanKernels().front());
  for (size_t count = 0; count <= beams.size(); count += count < 12 ? 1 : 191) {
    const absl::Span<const PlacedBeam> some(beams.data(), count);
    const absl::Span<const Face> expected = plain.Find(some);
    for (const ScanKernel& kernel : ScanKernels()) {
      FaceFinder finder(kKnotsPerM, kernel);
      const absl::Span<const Face> faces = finder.Find(some);
      for (size_t k = 0; k < count; ++k) {
        EXPECT_EQ(std::memcmp(&faces[k], &expected[k], offsetof(Face, weight)), 0) << kernel.name;
        EXPECT_EQ(faces[k].weight, expected[k].weight) << kernel.name;
      }
    }
  }
}

TEST(FacesTest, OneBeamAndNoneAreAllRight) {
  EXPECT_TRUE(Find({}).empty());
  EXPECT_EQ(Find({Beam(0, 1)})[0].normal[0], 1);
  PlacedBeam no_hit = Beam(0, 1);
  no_hit.hit = false;
  EXPECT_EQ(Find({no_hit, Beam(1, 1), no_hit}).size(), 3u);
}

}  // namespace splinemap::faces_test
