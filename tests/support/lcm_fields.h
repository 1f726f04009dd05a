#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "absl/types/span.h"

namespace splinemap {

// A message, or a part of one, as a tree.
struct LcmValue {
  std::string name;       // of the member
  std::string type;       // a primitive type of LCM, or the name of a struct
  std::string dimension;  // of an array: the member that counts its elements
  std::string bytes;  // of a primitive, big-endian; of a string, its text; of a message, its hash
  std::vector<LcmValue> parts;  // of a struct its members, of an array its elements

  bool operator==(const LcmValue&) const = default;
};

// A number or text in a message.
struct LcmField {
  std::string path;  // "digest.layer.name", "tiles[0].tx"
  LcmValue* value;   // valid as long as its message is not resized
  LcmValue* owner;   // the struct that it is a member of; null for an element
  bool is_count;     // of elements
};

// The types of all .lcm files in a folder, as text, so that tests reach every field without naming
// it. Throws std::runtime_error where a file or a message is not as it should be.
class LcmTypes {
 public:
  explicit LcmTypes(const std::string& folder);

  // Those that are no part of others.
  std::vector<std::string> Messages() const;

  LcmValue Parse(const std::string& type, absl::Span<const uint8_t> message) const;

 private:
  struct Member {
    std::string type;
    std::string name;
    std::string dimension;
  };

  bool IsStruct(const std::string& type) const { return structs_.contains(type); }
  void ReadFile(const std::string& path);
  LcmValue Take(const std::string& type, absl::Span<const uint8_t>& rest) const;

  std::map<std::string, std::vector<Member>> structs_;
};

// The bytes that Parse() takes. Counts are what they say, whatever there is.
std::vector<uint8_t> Encode(const LcmValue& message);

// In their order; all elements of arrays.
std::vector<LcmField> FieldsOf(LcmValue& message);

// Gives all arrays that `count` counts that many elements: the first ones that there are, then
// copies of the last. With `apart` copies differ in all their numbers. Arrays without elements stay
// so.
void Resize(const LcmField& count, size_t size, bool apart);

// Extreme values of the primitive other than its own, each once; of its length in bytes unless it
// is text.
std::vector<std::string> ExtremesOf(const LcmValue& value);

// Of the primitive, as text.
std::string Show(const LcmValue& value);

}  // namespace splinemap
