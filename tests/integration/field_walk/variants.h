#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "absl/functional/function_ref.h"
#include "absl/types/span.h"
#include "tests/support/lcm_fields.h"

namespace splinemap {

// One field, or a pair of them, and what it is set to.
struct Variant {
  struct Change {
    std::string path;
    std::string bytes;
    std::optional<size_t> size;  // of the arrays that the field counts, in place of `bytes`
    bool apart = false;
  };
  std::vector<Change> changes;
  std::string text;  // "layer.origin = 1"
};

// How many pairs of values each pair of fields is set to, beside single fields: what
// SPLINEMAP_WALK_PAIRS says, else none.
int PairsOfValues();

// All fields of a message, elements of arrays by their first one, to all their extremes, arrays to
// none, one and more elements than any message has, and PairsOfValues().
std::vector<Variant> VariantsOf(LcmValue message);

// Requires a message of the same type.
std::vector<uint8_t> Apply(const Variant& variant, LcmValue message);

// Runs `run`, which says what is wrong, empty where nothing is, with all of `variants` in batches
// of `batch`; what is wrong with which of them, each found by halving the batch. A batch of which
// no half is wrong is named as a whole.
using RunVariants = absl::FunctionRef<std::string(absl::Span<const Variant>)>;
std::vector<std::string> FindCulprits(absl::Span<const Variant> variants, size_t batch,
                                      RunVariants run);

// What a walk has tried, printed at its end.
class Tally {
 public:
  explicit Tally(std::string subject) : subject_(std::move(subject)) {}
  ~Tally();
  void Add(const std::vector<Variant>& variants);
  void Add(size_t fields, size_t values);

 private:
  const std::string subject_;
  size_t fields_ = 0;
  size_t values_ = 0;
};

const LcmTypes& Types();

// The message's type without its package.
std::string TypeNameOf(absl::Span<const uint8_t> message);

}  // namespace splinemap
