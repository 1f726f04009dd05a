#include "tests/bench/accuracy/score.h"

#include <gtest/gtest.h>

#include <cmath>

namespace splinemap::score_test {

TEST(ScoreTest, AucOfAPerfectMapIsOneAndOfItsOppositeZero) {
  EXPECT_EQ(Auc({1, 2, 3}, {-1, 0}), 1);
  EXPECT_EQ(Auc({-1, 0}, {1, 2, 3}), 0);
}

TEST(ScoreTest, TiesCountHalf) {
  EXPECT_EQ(Auc({0, 0}, {0, 0, 0}), 0.5);
  EXPECT_EQ(Auc({0, 1}, {0, 0}), 0.75);
}

TEST(ScoreTest, AMapThatKnowsNothingHasTheLikelihoodOfACoin) {
  EXPECT_NEAR(MeanLogLikelihood({0, 0}, {0}), std::log(0.5), 1e-12);
}

TEST(ScoreTest, AWrongPointOfASureMapIsBadButNotInfinitely) {
  EXPECT_NEAR(MeanLogLikelihood({-100}, {}), std::log(kMinProbability), 1e-12);
  EXPECT_NEAR(MeanLogLikelihood({}, {-100}), std::log(1 - kMinProbability), 1e-12);
}

TEST(ScoreTest, MappingErrorIsZeroWhereEveryHitIsOccupiedAndFourForEachThatIsFree) {
  EXPECT_EQ(MappingError({1, 1}), 0);
  EXPECT_EQ(MappingError({1, -1, 0}), 5);
}

TEST(ScoreTest, QuantilesAreAmongTheValues) {
  EXPECT_EQ(Quantile({3, 1, 2}, 0), 1);
  EXPECT_EQ(Quantile({3, 1, 2}, 0.5), 2);
  EXPECT_EQ(Quantile({4, 1, 3, 2}, 0.5), 2);
  EXPECT_EQ(Quantile({3, 1, 2}, 1), 3);
}

}  // namespace splinemap::score_test
