#pragma once

#include <array>
#include <functional>
#include <random>
#include <string>
#include <vector>

#include "tests/bench/accuracy/effort.h"
#include "tests/bench/accuracy/tested_map.h"

namespace splinemap {

// A room around the sensor at the origin: the distance of its wall by bearing.
using Room = std::function<double(double bearing_rad)>;
Room SquareRoom(double half_side_m);
Room CircularRoom(double radius_m);

// 360 beams 1 degree apart, with Gaussian noise of the range.
std::vector<PlacedBeam> ScanRoom(const Room& room, double range_sigma_m, std::mt19937_64& random);

// Where the beams of a noiseless scan end.
std::vector<Eigen::Vector2d> TrueHits(const Room& room);

// Half sides of the squares of Fig. 3.
inline constexpr std::array<double, 10> kFig3HalfSides_m = {2.00, 2.01, 2.02, 2.03, 2.04,
                                                            2.05, 2.06, 2.07, 2.08, 2.09};

// The error (37) of the map of `scans` scans at resolution 0.1 m.
double RoomError(const Method& method, const Room& room, double range_sigma_m, int scans,
                 uint64_t seed);
// The same of `runs` maps of the circle of the paper's Fig. 5.
std::vector<double> CircleErrors(const Method& method, double range_sigma_m, int scans, int runs);

// The paper's Fig. 3: fig3.csv, error by half side of the square.
void WriteFig3(const std::vector<Method>& methods, const Effort& effort, const std::string& out);
// Fig. 5: fig5.csv, quartiles of the error in the circle by noise.
void WriteFig5(const std::vector<Method>& methods, const Effort& effort, const std::string& out);
// Fig. 2 and 4: matrices map_SCENE_NUMBER.csv of the scaled map, and maps.csv, their list.
void WriteMaps(const std::vector<Method>& methods, const Effort& effort, const std::string& out);

}  // namespace splinemap
