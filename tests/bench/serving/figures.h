#pragma once

#include <string>
#include <vector>

namespace splinemap::bench {

// What was measured for one workload; the first competitor is what the others are compared with.
struct Figures {
  struct Competitor {
    std::string name;
    std::vector<double> values;  // as many as units
  };
  std::string workload;
  std::vector<std::string> units;
  std::vector<Competitor> competitors;
};

}  // namespace splinemap::bench
