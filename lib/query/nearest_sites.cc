#include "lib/query/nearest_sites.h"

#include <algorithm>
#include <cstdlib>

namespace splinemap {
namespace {

constexpr int kUnits = 8;  // to a knot interval

int32_t SquaredDistance(const Site& a, const Site& b) {
  return (a.x - b.x) * (a.x - b.x) + (a.y - b.y) * (a.y - b.y);
}

bool IsLess(const Site& a, const Site& b) { return a.y != b.y ? a.y < b.y : a.x < b.x; }

// Copies to `kept`, which has room for all of them, and returns how many.
size_t Keep(const Site* sites, size_t count, const VertexBox& box, Site* kept) {
  const Site centre{kUnits / 2 * (box.x0 + box.x1), kUnits / 2 * (box.y0 + box.y1)};
  const int32_t half_x = kUnits / 2 * (box.x1 - box.x0);
  const int32_t half_y = kUnits / 2 * (box.y1 - box.y0);
  size_t nearest = 0;
  int32_t least = SquaredDistance(sites[0], centre);
  for (size_t k = 1; k < count; ++k) {
    const int32_t squared = SquaredDistance(sites[k], centre);
    nearest = squared < least ? k : nearest;
    least = std::min(squared, least);
  }
  // |v - a|^2 - |v - b|^2 is linear in v: at the centre the one side, over the box the other at
  // most more.
  const Site best = sites[nearest];
  size_t num_kept = 0;
  for (size_t k = 0; k < count; ++k) {
    const Site site = sites[k];
    const int32_t slack =
        2 * (half_x * std::abs(site.x - best.x) + half_y * std::abs(site.y - best.y));
    kept[num_kept] = site;
    num_kept += SquaredDistance(site, centre) - least <= slack ? 1 : 0;
  }
  return num_kept;
}

}  // namespace

void NearestSites::LeaveOut(std::vector<Site>& sites, const VertexBox& box) {
  if (!sites.empty()) sites.resize(Keep(sites.data(), sites.size(), box, sites.data()));
}

void NearestSites::Find(const std::vector<Site>& sites, const VertexBox& box, Visitor visit) {
  if (sites.empty()) return;
  stack_ = sites;
  Split(0, stack_.size(), box, visit);
}

void NearestSites::Split(size_t begin, size_t end, const VertexBox& box, Visitor visit) {
  const size_t count = end - begin;
  if (count == 1) {
    for (int y = box.y0; y <= box.y1; ++y) {
      for (int x = box.x0; x <= box.x1; ++x) visit(x, y, stack_[begin]);
    }
    return;
  }
  if (stack_.size() < end + count) stack_.resize(end + count);
  const size_t kept = end + Keep(&stack_[begin], count, box, &stack_[end]);
  if (box.x0 == box.x1 && box.y0 == box.y1) {
    visit(box.x0, box.y0, *std::min_element(stack_.begin() + end, stack_.begin() + kept, IsLess));
    return;
  }
  VertexBox first = box;
  VertexBox second = box;
  if (box.x1 - box.x0 >= box.y1 - box.y0) {
    first.x1 = (box.x0 + box.x1) / 2;
    second.x0 = first.x1 + 1;
  } else {
    first.y1 = (box.y0 + box.y1) / 2;
    second.y0 = first.y1 + 1;
  }
  Split(end, kept, first, visit);
  Split(end, kept, second, visit);
}

}  // namespace splinemap
