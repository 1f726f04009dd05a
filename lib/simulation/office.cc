#include "lib/simulation/simulation.h"

namespace splinemap {
namespace {

constexpr double kDoorCloses_s = 60;

class Builder {
 public:
  void Wall(double x0, double y0, double x1, double y1, double from_s = 0) {
    simulation::Wall& wall = *world_.add_wall();
    wall.set_x0_m(x0);
    wall.set_y0_m(y0);
    wall.set_x1_m(x1);
    wall.set_y1_m(y1);
    if (from_s > 0) wall.set_from_s(from_s);
  }

  void Box(double x0, double y0, double x1, double y1) {
    Wall(x0, y0, x1, y0);
    Wall(x1, y0, x1, y1);
    Wall(x1, y1, x0, y1);
    Wall(x0, y1, x0, y0);
  }

  // A wall along x at height y with gaps of 1 m for doors, centred at `doors`.
  void WallWithDoors(double x0, double x1, double y, std::initializer_list<double> doors) {
    double begin = x0;
    for (const double door : doors) {
      Wall(begin, y, door - 0.5, y);
      begin = door + 0.5;
    }
    Wall(begin, y, x1, y);
  }

  void Pillar(double x, double y, double radius) {
    simulation::Pillar& pillar = *world_.add_pillar();
    pillar.set_x_m(x);
    pillar.set_y_m(y);
    pillar.set_radius_m(radius);
  }

  // Four legs of 5 cm.
  void Furniture(double x, double y, double width, double depth) {
    for (const double dx : {0.0, width}) {
      for (const double dy : {0.0, depth}) Pillar(x + dx, y + dy, 0.025);
    }
  }

  void Waypoint(double x, double y) {
    simulation::Waypoint& waypoint = *world_.add_waypoint();
    waypoint.set_x_m(x);
    waypoint.set_y_m(y);
  }

  simulation::World Take() { return std::move(world_); }

 private:
  simulation::World world_;
};

}  // namespace

simulation::World OfficeFloor() {
  Builder office;
  office.Box(0, 0, 24, 13);
  // Corridor from y = 5.5 to 7.5, three rooms below, two rooms and a hall above.
  office.WallWithDoors(0, 24, 5.5, {3, 11, 19});
  office.WallWithDoors(0, 24, 7.5, {3, 9, 16, 20});
  for (const double x : {7.0, 15.0}) office.Wall(x, 0, x, 5.5);
  for (const double x : {6.0, 12.0}) office.Wall(x, 7.5, x, 13);
  // The door of the room in the lower left closes.
  office.Wall(2.5, 5.5, 3.5, 5.5, kDoorCloses_s);

  for (const double x : {14.5, 18.0, 21.5}) {
    for (const double y : {9.3, 11.3}) office.Pillar(x, y, 0.25);
  }
  office.Furniture(1.0, 1.0, 1.6, 0.8);
  office.Furniture(1.5, 2.2, 0.45, 0.45);
  office.Furniture(4.6, 3.4, 1.6, 0.8);
  office.Furniture(5.1, 2.5, 0.45, 0.45);
  office.Furniture(8.0, 0.8, 2.4, 1.2);
  for (const double x : {8.2, 9.0, 9.8}) office.Furniture(x, 2.3, 0.45, 0.45);
  office.Furniture(16.5, 1.2, 1.6, 0.8);
  office.Furniture(21.0, 3.6, 1.6, 0.8);
  office.Furniture(21.5, 2.7, 0.45, 0.45);
  office.Furniture(1.0, 11.2, 1.6, 0.8);
  office.Furniture(7.5, 10.8, 1.6, 0.8);
  office.Furniture(8.0, 9.9, 0.45, 0.45);
  office.Box(23.2, 5.9, 23.9, 6.5);     // cupboard at the end of the corridor
  office.Box(12.1, 0.1, 14.9, 0.6);     // shelf
  office.Wall(9.0, 12.99, 11.0, 12.4);  // a board that leans on the wall

  for (const auto& [x, y] : std::initializer_list<std::pair<double, double>>{
           {1, 6.5},  {3, 6.5},   {3, 4.2},  {4.2, 1.8},  {3, 4.2},     {3, 6.5},     {9, 6.5},
           {9, 9},    {10.8, 11}, {9, 9},    {9, 6.5},    {11, 6.5},    {11, 3.8},    {13.3, 1.8},
           {11, 3.8}, {11, 6.5},  {16, 6.5}, {16, 8.4},   {16.2, 10.3}, {19.8, 10.3}, {20, 8.4},
           {20, 6.5}, {19, 6.5},  {19, 3},   {17, 3.2},   {19, 3},      {19, 6.5},    {22.3, 6.5},
           {12, 6.5}, {3, 6.5},   {3, 9.5},  {4.5, 11.5}, {3, 9.5},     {3, 6.5},     {1, 6.5}}) {
    office.Waypoint(x, y);
  }
  return office.Take();
}

}  // namespace splinemap
