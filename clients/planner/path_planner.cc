#include "clients/planner/path_planner.h"

#include <ompl/base/MotionValidator.h>
#include <ompl/base/OptimizationObjective.h>
#include <ompl/base/samplers/informed/PathLengthDirectInfSampler.h>
#include <ompl/base/spaces/RealVectorStateSpace.h>
#include <ompl/geometric/PathSimplifier.h>
#include <ompl/geometric/SimpleSetup.h>
#include <ompl/geometric/planners/informedtrees/BITstar.h>
#include <ompl/util/Console.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <utility>

#include "lib/base/clock.h"
#include "lib/base/status.h"

namespace splinemap {
namespace {

namespace ob = ompl::base;
namespace og = ompl::geometric;
using Eigen::Vector2d;

constexpr double kNearCost = 4;      // of a metre beside an obstacle; in the open it is 1
constexpr double kCostStep_m = 0.1;  // between points whose clearance is asked for

Vector2d PointOf(const ob::State* state) {
  const auto* point = state->as<ob::RealVectorStateSpace::StateType>();
  return {point->values[0], point->values[1]};
}

ob::ScopedState<> StateOf(const ob::StateSpacePtr& space, const Vector2d& point_m) {
  ob::ScopedState<> state(space);
  state[0] = point_m.x();
  state[1] = point_m.y();
  return state;
}

// What OMPL asks about the map. OMPL takes no errors: after one, everything is occupied.
class Questions {
 public:
  Questions(const QueryableMap& map, const PlannerOptions& options)
      : map_(map), options_(options) {}

  const absl::Status& status() const { return status_; }

  SweepsQuery::Result Sweep(Path path_m) {
    SweepsQuery query;
    query.sweeps = {{std::move(path_m), options_.radius_m}};
    const auto answer = map_.Ask(query);
    status_.Update(answer.status());
    return answer.ok() ? answer->results.front()
                       : SweepsQuery::Result{.occupancy = Occupancy::kOccupied};
  }

  // The length of the way, where a metre near obstacles counts more.
  double Cost(const Vector2d& from_m, const Vector2d& to_m) {
    const double length_m = (to_m - from_m).norm();
    const int steps = static_cast<int>(std::ceil(length_m / kCostStep_m));
    DistancesQuery query;
    query.max_distance_m = options_.clearance_m;
    for (int k = 0; k < steps; ++k) {
      query.points_m.emplace_back(from_m + (to_m - from_m) * (k + 0.5) / steps);
    }
    const auto answer = map_.Ask(query);
    status_.Update(answer.status());
    if (!answer.ok()) return length_m;
    double cost = 0;
    for (const DistancesQuery::Distance& distance : answer->distances) {
      const double nearness = 1 - distance.distance_m / options_.clearance_m;
      cost += 1 + (kNearCost - 1) * nearness * nearness;
    }
    return steps > 0 ? cost * length_m / steps : 0;
  }

 private:
  const QueryableMap& map_;
  const PlannerOptions options_;
  absl::Status status_;
};

class SweptMotions : public ob::MotionValidator {
 public:
  SweptMotions(ob::SpaceInformation* space, Questions& questions)
      : ob::MotionValidator(space), questions_(questions) {}

  bool checkMotion(const ob::State* from, const ob::State* to) const override {
    return questions_.Sweep({PointOf(from), PointOf(to)}).occupancy == Occupancy::kFree;
  }
  bool checkMotion(const ob::State* from, const ob::State* to,
                   std::pair<ob::State*, double>& last_valid) const override {
    const auto result = questions_.Sweep({PointOf(from), PointOf(to)});
    if (result.occupancy == Occupancy::kFree) return true;
    const double length_m = (PointOf(to) - PointOf(from)).norm();
    last_valid.second = length_m > 0 ? std::min(result.free_m / length_m, 1.0) : 0;
    if (last_valid.first != nullptr) {
      si_->getStateSpace()->interpolate(from, to, last_valid.second, last_valid.first);
    }
    return false;
  }

 private:
  Questions& questions_;
};

class LengthAndClearance : public ob::OptimizationObjective {
 public:
  LengthAndClearance(const ob::SpaceInformationPtr& space, Questions& questions)
      : ob::OptimizationObjective(space), questions_(questions) {}

  ob::Cost stateCost(const ob::State*) const override { return identityCost(); }
  ob::Cost motionCost(const ob::State* from, const ob::State* to) const override {
    return ob::Cost(questions_.Cost(PointOf(from), PointOf(to)));
  }
  // No metre costs less than 1, so what is known of shortest paths holds for the cheapest, too.
  ob::Cost motionCostHeuristic(const ob::State* from, const ob::State* to) const override {
    return ob::Cost(si_->distance(from, to));
  }
  ob::InformedSamplerPtr allocInformedStateSampler(const ob::ProblemDefinitionPtr& problem,
                                                   unsigned int max_calls) const override {
    return std::make_shared<ob::PathLengthDirectInfSampler>(problem, max_calls);
  }

 private:
  Questions& questions_;
};

}  // namespace

absl::StatusOr<Path> PlanPath(const QueryableMap& map, const Region& bounds,
                              const Vector2d& start_m, const Vector2d& goal_m,
                              const PlannerOptions& options) {
  ompl::msg::setLogLevel(ompl::msg::LOG_ERROR);
  Questions questions(map, options);
  for (const auto& [name, point_m] : {std::pair("start", start_m), std::pair("goal", goal_m)}) {
    const bool is_free = questions.Sweep({point_m}).occupancy == Occupancy::kFree;
    SPLINEMAP_RETURN_IF_ERROR(questions.status());
    if (!is_free) {
      return NotFound("the {} ({:.2f}, {:.2f}) m has no {} m of free space around it", name,
                      point_m.x(), point_m.y(), options.radius_m);
    }
  }

  const auto plane = std::make_shared<ob::RealVectorStateSpace>();
  plane->addDimension(bounds.x0_m, bounds.x1_m);
  plane->addDimension(bounds.y0_m, bounds.y1_m);
  og::SimpleSetup setup(plane);
  const ob::SpaceInformationPtr& space = setup.getSpaceInformation();
  space->setStateValidityChecker([&](const ob::State* state) {
    return space->satisfiesBounds(state) &&
           questions.Sweep({PointOf(state)}).occupancy == Occupancy::kFree;
  });
  space->setMotionValidator(std::make_shared<SweptMotions>(space.get(), questions));
  setup.setStartAndGoalStates(StateOf(plane, start_m), StateOf(plane, goal_m));
  setup.setOptimizationObjective(std::make_shared<LengthAndClearance>(space, questions));
  const auto planner = std::make_shared<og::BITstar>(space);
  setup.setPlanner(planner);

  const auto begin = Clock::now();
  setup.solve(ob::PlannerTerminationCondition([&] {
    const auto elapsed = Clock::now() - begin;
    return !questions.status().ok() || elapsed > options.give_up_after ||
           (elapsed > options.improve_for && std::isfinite(planner->bestCost().value()));
  }));
  SPLINEMAP_RETURN_IF_ERROR(questions.status());
  if (!setup.haveExactSolutionPath()) {
    return NotFound("no way from ({:.2f}, {:.2f}) to ({:.2f}, {:.2f}) m was found in {} ms",
                    start_m.x(), start_m.y(), goal_m.x(), goal_m.y(),
                    options.give_up_after.count());
  }
  og::PathGeometric& solution = setup.getSolutionPath();
  og::PathSimplifier simplifier(space, setup.getGoal(), setup.getOptimizationObjective());
  simplifier.shortcutPath(solution);
  SPLINEMAP_RETURN_IF_ERROR(questions.status());
  Path path;
  for (const ob::State* state : solution.getStates()) path.push_back(PointOf(state));
  return path;
}

absl::StatusOr<bool> IsFree(const QueryableMap& map, const Path& path, double radius_m) {
  SweepsQuery query;
  query.sweeps = {{path, radius_m}};
  SPLINEMAP_ASSIGN_OR_RETURN(const SweepsQuery::Answer answer, map.Ask(query));
  return answer.results.front().occupancy == Occupancy::kFree;
}

}  // namespace splinemap
