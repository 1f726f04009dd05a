#include "tests/integration/field_walk/variants.h"

#include <algorithm>
#include <cstdlib>
#include <random>
#include <set>

#include "absl/strings/match.h"
#include "absl/strings/str_replace.h"
#include "fmt/core.h"
#include "lib/wire/message_type.h"

namespace splinemap {
namespace {

// More than any message has, as equal ones and as different ones.
constexpr size_t kSizes[] = {0, 1, 2, 100, 1001};

// So that a fault of many values does not take hours.
constexpr size_t kMaxCulprits = 10;

// Of one field each, none for elements that are not the first.
std::vector<std::vector<Variant>> SingleVariants(LcmValue& message) {
  std::vector<std::vector<Variant>> all;
  for (const LcmField& field : FieldsOf(message)) {
    if (absl::StrContains(absl::StrReplaceAll(field.path, {{"[0]", ""}}), "[")) continue;
    std::vector<Variant>& variants = all.emplace_back();
    for (const std::string& bytes : ExtremesOf(*field.value)) {
      LcmValue value = *field.value;
      value.bytes = bytes;
      variants.push_back(
          {{{field.path, bytes, {}, false}}, fmt::format("{} = {}", field.path, Show(value))});
    }
    if (!field.is_count || Show(*field.value) == "0") continue;
    for (const size_t size : kSizes) {
      for (const bool apart : {false, true}) {
        variants.push_back(
            {{{field.path, "", size, apart}},
             fmt::format("{} = {} {} elements", field.path, size, apart ? "different" : "equal")});
      }
    }
  }
  return all;
}

void AddCulprits(absl::Span<const Variant> variants, RunVariants run,
                 std::vector<std::string>& culprits) {
  if (variants.empty() || culprits.size() >= kMaxCulprits) return;
  const std::string wrong = run(variants);
  if (wrong.empty()) return;
  const size_t before = culprits.size();
  if (const size_t half = variants.size() / 2; half > 0) {
    AddCulprits(variants.first(half), run, culprits);
    AddCulprits(variants.subspan(half), run, culprits);
  }
  if (culprits.size() > before) return;
  culprits.push_back(fmt::format("{}{}: {}", variants.front().text,
                                 variants.size() > 1 ? " .. " + variants.back().text : "", wrong));
}

}  // namespace

int PairsOfValues() {
  const char* variable = std::getenv("SPLINEMAP_WALK_PAIRS");
  return variable == nullptr ? 0 : std::atoi(variable);
}

std::vector<Variant> VariantsOf(LcmValue message) {
  const auto single = SingleVariants(message);
  std::vector<Variant> all;
  for (const auto& variants : single) all.insert(all.end(), variants.begin(), variants.end());
  std::mt19937_64 random(1);
  const auto draw = [&](const std::vector<Variant>& variants) {
    return variants[std::uniform_int_distribution<size_t>(0, variants.size() - 1)(random)];
  };
  const int pairs = PairsOfValues();
  for (size_t a = 0; pairs > 0 && a < single.size(); ++a) {
    for (size_t b = a + 1; b < single.size(); ++b) {
      for (int n = 0; n < pairs; ++n) {
        Variant pair = draw(single[a]);
        const Variant second = draw(single[b]);
        // Sizes last, since what they cut off may be what the other one sets.
        const bool is_size = pair.changes[0].size.has_value();
        pair.changes.insert(is_size ? pair.changes.begin() : pair.changes.end(), second.changes[0]);
        pair.text += ", " + second.text;
        all.push_back(std::move(pair));
      }
    }
  }
  return all;
}

std::vector<uint8_t> Apply(const Variant& variant, LcmValue message) {
  for (const Variant::Change& change : variant.changes) {
    const std::vector<LcmField> fields = FieldsOf(message);
    const auto field = std::find_if(fields.begin(), fields.end(),
                                    [&](const auto& f) { return f.path == change.path; });
    if (field == fields.end()) continue;  // an element of an array that is empty now
    if (change.size) {
      Resize(*field, *change.size, change.apart);
    } else {
      field->value->bytes = change.bytes;
    }
  }
  return Encode(message);
}

std::vector<std::string> FindCulprits(absl::Span<const Variant> variants, size_t batch,
                                      RunVariants run) {
  std::vector<std::string> culprits;
  for (size_t k = 0; k < variants.size(); k += batch) {
    AddCulprits(variants.subspan(k, batch), run, culprits);
  }
  return culprits;
}

Tally::~Tally() { fmt::print("{}: {} fields, {} values\n", subject_, fields_, values_); }

void Tally::Add(size_t fields, size_t values) {
  fields_ += fields;
  values_ += values;
}

void Tally::Add(const std::vector<Variant>& variants) {
  std::set<std::string> paths;
  for (const Variant& variant : variants) {
    for (const auto& change : variant.changes) paths.insert(change.path);
  }
  Add(paths.size(), variants.size());
}

const LcmTypes& Types() {
  static const LcmTypes kTypes(SPLINEMAP_LCM_TYPES);
  return kTypes;
}

std::string TypeNameOf(absl::Span<const uint8_t> message) {
  const std::string name = TypeName(TypeOf(message).value());
  return name.substr(name.find('.') + 1);
}

}  // namespace splinemap
