#include "lib/config/checked_text.h"

#include <google/protobuf/descriptor.h>
#include <google/protobuf/io/tokenizer.h>
#include <google/protobuf/text_format.h>

#include <algorithm>
#include <cmath>
#include <optional>
#include <sstream>
#include <vector>

#include "absl/strings/str_split.h"
#include "lib/base/did_you_mean.h"
#include "lib/base/status.h"
#include "lib/config/field_rules.pb.h"

namespace splinemap {
namespace {

using google::protobuf::FieldDescriptor;
using google::protobuf::Message;
using google::protobuf::Reflection;
using google::protobuf::TextFormat;

std::vector<std::string> FieldNames(const google::protobuf::Descriptor& type) {
  std::vector<std::string> names;
  for (int k = 0; k < type.field_count(); ++k) names.push_back(type.field(k)->name());
  return names;
}

// Of a message of Protobuf's parser about a field that does not exist: Message type "TYPE" has no
// field named "NAME".
std::string DidYouMeanField(const std::string& message) {
  const std::vector<std::string> parts = absl::StrSplit(message, '"');
  if (parts.size() < 4 || parts[2] != " has no field named ") return "";
  const auto* type =
      google::protobuf::DescriptorPool::generated_pool()->FindMessageTypeByName(parts[1]);
  return type == nullptr ? "" : DidYouMean(parts[3], FieldNames(*type));
}

class ErrorList : public google::protobuf::io::ErrorCollector {
 public:
  explicit ErrorList(std::string source) : source_(std::move(source)) {}

  void AddError(int line, google::protobuf::io::ColumnNumber column,
                const std::string& message) override {
    if (!text_.empty()) text_ += '\n';
    text_ += line < 0 ? fmt::format("{}: {}", source_, message)
                      : fmt::format("{}:{}:{}: {}", source_, line + 1, column + 1, message);
    text_ += DidYouMeanField(message);
  }

  absl::Status ToStatus() const {
    return text_.empty() ? absl::OkStatus() : absl::InvalidArgumentError(text_);
  }

 private:
  std::string source_;
  std::string text_;
};

const config::FieldRules& RulesOf(const FieldDescriptor& field) {
  return field.options().GetExtension(config::rules);
}

// As in text format. `index` is -1 for a field that is not repeated.
std::string ValueText(const Message& message, const FieldDescriptor& field, int index) {
  std::string text;
  TextFormat::PrintFieldValueToString(message, &field, index, &text);
  return text;
}

// As on the command line.
std::string PlainText(const Message& message, const FieldDescriptor& field, int index) {
  if (field.cpp_type() != FieldDescriptor::CPPTYPE_STRING) return ValueText(message, field, index);
  const Reflection& reflection = *message.GetReflection();
  return field.is_repeated() ? reflection.GetRepeatedString(message, &field, index)
                             : reflection.GetString(message, &field);
}

std::optional<double> NumberOf(const Message& message, const FieldDescriptor& field) {
  const Reflection& reflection = *message.GetReflection();
  switch (field.cpp_type()) {
    case FieldDescriptor::CPPTYPE_DOUBLE:
      return reflection.GetDouble(message, &field);
    case FieldDescriptor::CPPTYPE_INT32:
      return reflection.GetInt32(message, &field);
    case FieldDescriptor::CPPTYPE_UINT32:
      return reflection.GetUInt32(message, &field);
    default:
      return std::nullopt;
  }
}

std::string RangeText(const config::FieldRules& rules) {
  if (rules.one_of_size() > 0) return fmt::format("{}", fmt::join(rules.one_of(), ", "));
  if (rules.has_min() && rules.has_max()) return fmt::format("{} .. {}", rules.min(), rules.max());
  if (rules.has_min()) return fmt::format("at least {}", rules.min());
  if (rules.has_max()) return fmt::format("at most {}", rules.max());
  return "";
}

// What is wrong with a field that is set, or an empty text.
std::string Complaint(const Message& message, const FieldDescriptor& field) {
  if (field.is_repeated()) return "";  // texts, which the user of the message checks
  const config::FieldRules& rules = RulesOf(field);
  const std::string value = PlainText(message, field, -1);
  const auto& one_of = rules.one_of();
  bool fits = one_of.empty() || std::find(one_of.begin(), one_of.end(), value) != one_of.end();
  if (const std::optional<double> number = NumberOf(message, field)) {
    fits = fits && std::isfinite(*number) && !(rules.has_min() && *number < rules.min()) &&
           !(rules.has_max() && *number > rules.max());
  }
  if (fits) return "";
  const std::string range = RangeText(rules);
  return fmt::format("{} is {}, allowed: {}", field.name(), value,
                     range.empty() ? "a finite number" : range);
}

void CheckFields(const Message& message, TextFormat::ParseInfoTree* locations, ErrorList& errors) {
  const Reflection& reflection = *message.GetReflection();
  std::vector<const FieldDescriptor*> fields;
  reflection.ListFields(message, &fields);
  for (const FieldDescriptor* field : fields) {
    if (field->cpp_type() == FieldDescriptor::CPPTYPE_MESSAGE) {
      const int count = field->is_repeated() ? reflection.FieldSize(message, field) : 1;
      for (int k = 0; k < count; ++k) {
        const Message& nested = field->is_repeated()
                                    ? reflection.GetRepeatedMessage(message, field, k)
                                    : reflection.GetMessage(message, field);
        CheckFields(nested, locations->GetTreeForNested(field, field->is_repeated() ? k : -1),
                    errors);
      }
    } else if (const std::string complaint = Complaint(message, *field); !complaint.empty()) {
      const TextFormat::ParseLocation location = locations->GetLocation(field, -1);
      errors.AddError(location.line, location.column, complaint);
    }
  }
}

class DocumentedPrinter {
 public:
  std::string Print(const Message& message) {
    Fields(message, "", false);
    return out_.str();
  }

 private:
  void Fields(const Message& message, const std::string& indent, bool commented) {
    const auto& descriptor = *message.GetDescriptor();
    for (int k = 0; k < descriptor.field_count(); ++k) {
      const FieldDescriptor& field = *descriptor.field(k);
      if (k > 0 && indent.empty()) out_ << '\n';
      Documentation(field, indent, commented);
      if (field.cpp_type() == FieldDescriptor::CPPTYPE_MESSAGE) {
        Nested(message, field, indent, commented);
      } else if (field.is_repeated()) {
        Repeated(message, field, indent, commented);
      } else {
        const bool is_set = message.GetReflection()->HasField(message, &field);
        out_ << Prefix(indent, commented || !is_set) << field.name() << ": "
             << ValueText(message, field, -1) << '\n';
      }
    }
  }

  void Nested(const Message& message, const FieldDescriptor& field, const std::string& indent,
              bool commented) {
    const Reflection& reflection = *message.GetReflection();
    const int count = field.is_repeated()                    ? reflection.FieldSize(message, &field)
                      : reflection.HasField(message, &field) ? 1
                                                             : 0;
    // Where there is none, one as an example.
    for (int k = 0; k < std::max(count, 1); ++k) {
      const bool is_example = commented || (count == 0 && field.is_repeated());
      const Message& nested =
          count == 0 ? *google::protobuf::MessageFactory::generated_factory()->GetPrototype(
                           field.message_type())
          : field.is_repeated() ? reflection.GetRepeatedMessage(message, &field, k)
                                : reflection.GetMessage(message, &field);
      out_ << Prefix(indent, is_example) << field.name() << " {\n";
      Fields(nested, indent + "  ", is_example);
      out_ << Prefix(indent, is_example) << "}\n";
    }
  }

  void Repeated(const Message& message, const FieldDescriptor& field, const std::string& indent,
                bool commented) {
    const int count = message.GetReflection()->FieldSize(message, &field);
    for (int k = 0; k < count; ++k) {
      out_ << Prefix(indent, commented) << field.name() << ": " << ValueText(message, field, k)
           << '\n';
    }
    if (count == 0) out_ << Prefix(indent, true) << field.name() << ": \"\"\n";
  }

  void Documentation(const FieldDescriptor& field, const std::string& indent, bool commented) {
    const config::FieldRules& rules = RulesOf(field);
    const std::string prefix = commented ? "#" + indent + "# " : indent + "# ";
    out_ << prefix << rules.doc() << '\n';
    if (const std::string range = RangeText(rules); !range.empty()) {
      out_ << prefix << "Default " << DefaultText(field) << ", allowed " << range << ".\n";
    } else if (field.has_default_value()) {
      out_ << prefix << "Default " << DefaultText(field) << ".\n";
    }
  }

  static std::string DefaultText(const FieldDescriptor& field) {
    const Message& prototype = *google::protobuf::MessageFactory::generated_factory()->GetPrototype(
        field.containing_type());
    return ValueText(prototype, field, -1);
  }

  static std::string Prefix(const std::string& indent, bool commented) {
    return commented ? "#" + indent : indent;
  }

  std::ostringstream out_;
};

}  // namespace

absl::Status ParseCheckedText(const std::string& text, const std::string& source,
                              Message* message) {
  ErrorList errors(source);
  TextFormat::ParseInfoTree locations;
  TextFormat::Parser parser;
  parser.RecordErrorsTo(&errors);
  parser.WriteLocationsTo(&locations);
  if (parser.ParseFromString(text, message)) CheckFields(*message, &locations, errors);
  return errors.ToStatus();
}

absl::Status SetCheckedField(const std::string& name, const std::string& value, Message* message) {
  const auto& descriptor = *message->GetDescriptor();
  const FieldDescriptor* field = descriptor.FindFieldByName(name);
  if (field == nullptr) {
    const std::vector<std::string> names = FieldNames(descriptor);
    return InvalidArgument("no option {}{}; there are {}", name, DidYouMean(name, names),
                           fmt::join(names, ", "));
  }
  if (!field->is_repeated()) message->GetReflection()->ClearField(message, field);
  const bool is_text = field->cpp_type() == FieldDescriptor::CPPTYPE_STRING;
  TextFormat::Parser parser;
  ErrorList ignored(name);
  parser.RecordErrorsTo(&ignored);
  if (!parser.ParseFieldValueFromString(is_text ? fmt::format("\"{}\"", value) : value, field,
                                        message)) {
    return InvalidArgument("{}={}: not a value of this option", name, value);
  }
  if (const std::string complaint = Complaint(*message, *field); !complaint.empty()) {
    return absl::InvalidArgumentError(complaint);
  }
  return absl::OkStatus();
}

std::vector<std::pair<std::string, std::string>> SetFields(const Message& message) {
  const Reflection& reflection = *message.GetReflection();
  std::vector<const FieldDescriptor*> fields;
  reflection.ListFields(message, &fields);
  std::vector<std::pair<std::string, std::string>> set;
  for (const FieldDescriptor* field : fields) {
    const int count = field->is_repeated() ? reflection.FieldSize(message, field) : 1;
    for (int k = 0; k < count; ++k) {
      set.emplace_back(field->name(), PlainText(message, *field, field->is_repeated() ? k : -1));
    }
  }
  return set;
}

std::string PrintDocumented(const Message& message) { return DocumentedPrinter().Print(message); }

}  // namespace splinemap
