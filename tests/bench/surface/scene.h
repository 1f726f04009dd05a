#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <random>
#include <string>
#include <vector>

#include "lib/simulation/simulation.h"
#include "splinemap/scan.h"

namespace splinemap {

// What a sensor of the bench is like, and how much it sees.
struct Sensing {
  int beams = 360;  // over a full turn
  double noise_sigma_m = 0.01;
  int scans = 100;
  double mixed_share = 0;  // of the beams at an edge that return a range between both sides
  double range_max_m = 30;
};

// A ray of a question, and the distance at which it meets a face.
struct TrueRay {
  Eigen::Vector2d origin_m;
  Eigen::Vector2d direction;  // unit length
  double range_m = 0;
  double cos_incidence = 1;  // errors along the ray times this are errors of the face
};

// Things of known geometry, a way of the sensor past them, and what is asked of the map. Lengths in
// metres, in the frame of the scene, which lies somewhere between the knots.
struct Scene {
  std::string name;
  simulation::World world;
  std::vector<Eigen::Vector2d> way_m;  // of the sensor, an equal share of the scans on each piece
  std::vector<TrueRay> rays;
  // Points and their distance to the nearest face.
  std::vector<std::pair<Eigen::Vector2d, double>> distances;
  // A gap across the x axis, at x = 0; 0: none.
  double gap_width_m = 0;
  // A pole at the origin; 0: none.
  double pole_diameter_m = 0;
};

// All scans of the sensor on its way, in the world frame.
std::vector<std::vector<PlacedBeam>> Scans(const Scene& scene, const Pose2& world_T_scene,
                                           const Sensing& sensing, uint64_t seed);

Scene WallScene(double distance_m, double incidence_deg);
// A thing of a straight wall's thickness; seen from one side or from both.
Scene ThinWallScene(double thickness_m, bool from_both_sides);
Scene CornerScene(bool convex);
Scene DoorScene(double width_m, double thickness_m);
Scene PoleScene(double diameter_m, bool from_all_sides);

}  // namespace splinemap
