#include "tests/support/lcm_fields.h"

#include <algorithm>
#include <bit>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <regex>
#include <set>
#include <sstream>
#include <stdexcept>

#include "absl/strings/escaping.h"
#include "fmt/format.h"
#include "tests/support/extremes.h"

namespace splinemap {
namespace {

size_t SizeOf(const std::string& primitive) {
  static const std::map<std::string, size_t> kSizes{{"boolean", 1}, {"byte", 1},    {"int8_t", 1},
                                                    {"int16_t", 2}, {"int32_t", 4}, {"int64_t", 8},
                                                    {"float", 4},   {"double", 8}};
  const auto size = kSizes.find(primitive);
  if (size == kSizes.end()) throw std::runtime_error("no type of LCM: " + primitive);
  return size->second;
}

template <typename Number>
std::string BigEndian(Number number) {
  std::string bytes(sizeof number, '\0');
  std::memcpy(bytes.data(), &number, sizeof number);
  std::reverse(bytes.begin(), bytes.end());
  return bytes;
}

template <typename Number>
Number NumberOf(std::string bytes) {
  std::reverse(bytes.begin(), bytes.end());
  Number number;
  std::memcpy(&number, bytes.data(), sizeof number);
  return number;
}

std::string ReadBytes(size_t size, absl::Span<const uint8_t>& rest) {
  if (size > rest.size()) throw std::runtime_error("a message that is too short for its type");
  const std::string bytes(rest.begin(), rest.begin() + static_cast<ptrdiff_t>(size));
  rest.remove_prefix(size);
  return bytes;
}

std::string ReadPrimitive(const std::string& type, absl::Span<const uint8_t>& rest) {
  if (type != "string") return ReadBytes(SizeOf(type), rest);
  std::string text = ReadBytes(NumberOf<uint32_t>(ReadBytes(4, rest)), rest);
  text.pop_back();  // the closing 0
  return text;
}

bool IsPrimitive(const LcmValue& value) { return value.parts.empty() && value.dimension.empty(); }

void Append(const LcmValue& value, std::string& bytes) {
  if (value.type == "string" && IsPrimitive(value)) {
    bytes += BigEndian(static_cast<uint32_t>(value.bytes.size() + 1));
    bytes += value.bytes;
    bytes += '\0';
    return;
  }
  bytes += value.bytes;
  for (const LcmValue& part : value.parts) Append(part, bytes);
}

bool Counts(const LcmValue& owner, const std::string& name) {
  return std::any_of(owner.parts.begin(), owner.parts.end(),
                     [&](const LcmValue& member) { return member.dimension == name; });
}

void AddFields(LcmValue& value, const std::string& path, LcmValue* owner,
               std::vector<LcmField>& fields) {
  if (IsPrimitive(value)) {
    fields.push_back({path, &value, owner, owner != nullptr && Counts(*owner, value.name)});
    return;
  }
  if (!value.dimension.empty()) {
    for (size_t k = 0; k < value.parts.size(); ++k) {
      AddFields(value.parts[k], fmt::format("{}[{}]", path, k), nullptr, fields);
    }
    return;
  }
  for (LcmValue& part : value.parts) {
    AddFields(part, path.empty() ? part.name : path + "." + part.name, &value, fields);
  }
}

void SetApart(LcmValue& element, uint16_t number) {
  for (const LcmField& field : FieldsOf(element)) {
    std::string& bytes = field.value->bytes;
    if (field.is_count || field.value->type == "string" || bytes.size() < 4) continue;
    bytes[bytes.size() - 2] ^= static_cast<char>(number >> 8);
    bytes[bytes.size() - 1] ^= static_cast<char>(number);
  }
}

template <typename Number>
std::vector<std::string> ExtremesAs(const std::string& bytes) {
  std::vector<std::string> values;
  for (const Number value : Extremes(NumberOf<Number>(bytes))) values.push_back(BigEndian(value));
  return values;
}

std::vector<std::string> AllExtremesOf(const LcmValue& value) {
  if (value.type == "string") return Extremes(value.bytes);
  if (value.type == "double") return ExtremesAs<double>(value.bytes);
  if (value.type == "float") return ExtremesAs<float>(value.bytes);
  switch (SizeOf(value.type)) {
    case 1:
      return ExtremesAs<int8_t>(value.bytes);
    case 2:
      return ExtremesAs<int16_t>(value.bytes);
    case 4:
      return ExtremesAs<int32_t>(value.bytes);
    default:
      return ExtremesAs<int64_t>(value.bytes);
  }
}

}  // namespace

LcmTypes::LcmTypes(const std::string& folder) {
  for (const auto& entry : std::filesystem::directory_iterator(folder)) {
    if (entry.path().extension() == ".lcm") ReadFile(entry.path());
  }
}

void LcmTypes::ReadFile(const std::string& path) {
  std::stringstream text;
  text << std::ifstream(path).rdbuf();
  const std::string code = std::regex_replace(text.str(), std::regex("//[^\n]*"), "");
  static const std::regex kStruct(R"(\s*package\s+\w+;\s*struct\s+(\w+)\s*\{([^}]*)\}\s*)");
  std::smatch found;
  if (!std::regex_match(code, found, kStruct)) {
    throw std::runtime_error(path + " is not one package and one struct");
  }
  std::vector<Member>& members = structs_[found[1]];
  std::stringstream body(found[2]);
  static const std::regex kMember(R"(\s*(\w+)\s+(\w+)\s*(?:\[\s*([a-z]\w*)\s*\])?\s*)");
  for (std::string member; std::getline(body, member, ';');) {
    if (member.find_first_not_of(" \n") == std::string::npos) continue;
    if (!std::regex_match(member, found, kMember)) {
      throw std::runtime_error(path + " has a member that tests cannot read:" + member);
    }
    members.push_back({found[1], found[2], found[3]});
  }
}

std::vector<std::string> LcmTypes::Messages() const {
  std::set<std::string> parts;
  for (const auto& [name, members] : structs_) {
    for (const Member& member : members) parts.insert(member.type);
  }
  std::vector<std::string> messages;
  for (const auto& [name, members] : structs_) {
    if (!parts.contains(name)) messages.push_back(name);
  }
  return messages;
}

LcmValue LcmTypes::Parse(const std::string& type, absl::Span<const uint8_t> message) const {
  const std::string hash = ReadBytes(8, message);
  LcmValue value = Take(type, message);
  value.bytes = hash;
  if (!message.empty()) throw std::runtime_error("a message that is too long for " + type);
  return value;
}

LcmValue LcmTypes::Take(const std::string& type, absl::Span<const uint8_t>& rest) const {
  LcmValue value;
  value.type = type;
  if (!IsStruct(type)) {
    value.bytes = ReadPrimitive(type, rest);
    return value;
  }
  std::map<std::string, int32_t> counts;
  for (const Member& member : structs_.at(type)) {
    LcmValue part;
    if (member.dimension.empty()) {
      part = Take(member.type, rest);
      if (member.type == "int32_t") counts[member.name] = NumberOf<int32_t>(part.bytes);
    } else {
      part.type = member.type;
      part.dimension = member.dimension;
      for (int32_t k = 0; k < counts.at(member.dimension); ++k) {
        part.parts.push_back(Take(member.type, rest));
      }
    }
    part.name = member.name;
    value.parts.push_back(std::move(part));
  }
  return value;
}

std::vector<uint8_t> Encode(const LcmValue& message) {
  std::string bytes;
  Append(message, bytes);
  return {bytes.begin(), bytes.end()};
}

std::vector<LcmField> FieldsOf(LcmValue& message) {
  std::vector<LcmField> fields;
  AddFields(message, "", nullptr, fields);
  return fields;
}

void Resize(const LcmField& count, size_t size, bool apart) {
  count.value->bytes = BigEndian(static_cast<int32_t>(size));
  for (LcmValue& array : count.owner->parts) {
    if (array.dimension != count.value->name) continue;
    if (array.parts.empty()) continue;
    const size_t before = array.parts.size();
    const LcmValue last = array.parts.back();
    array.parts.resize(size, last);
    for (size_t k = before; apart && k < size; ++k) {
      SetApart(array.parts[k], static_cast<uint16_t>(k));
    }
  }
}

std::vector<std::string> ExtremesOf(const LcmValue& value) {
  std::vector<std::string> values = AllExtremesOf(value);
  std::sort(values.begin(), values.end());
  values.erase(std::unique(values.begin(), values.end()), values.end());
  std::erase(values, value.bytes);
  return values;
}

std::string Show(const LcmValue& value) {
  if (value.type == "string") {
    return fmt::format("\"{}\" ({} bytes)", absl::CHexEscape(value.bytes.substr(0, 40)),
                       value.bytes.size());
  }
  if (value.type == "double") return fmt::format("{}", NumberOf<double>(value.bytes));
  if (value.type == "float") return fmt::format("{}", NumberOf<float>(value.bytes));
  switch (SizeOf(value.type)) {
    case 1:
      return fmt::format("{}", int{NumberOf<int8_t>(value.bytes)});
    case 2:
      return fmt::format("{}", NumberOf<int16_t>(value.bytes));
    case 4:
      return fmt::format("{}", NumberOf<int32_t>(value.bytes));
    default:
      return fmt::format("{}", NumberOf<int64_t>(value.bytes));
  }
}

}  // namespace splinemap
