#pragma once

#include <google/protobuf/message.h>

#include <string>
#include <utility>
#include <vector>

#include "absl/status/status.h"

namespace splinemap {

// Protobuf text format with the rules of field_rules.proto, for any message.

// Parses `text` into `message` and checks the rules of every field that is set. InvalidArgument
// with a line "source:line:column: what" for each error; unknown fields, values that are not finite
// and values out of range are errors. *message is unspecified after a failure.
absl::Status ParseCheckedText(const std::string& text, const std::string& source,
                              google::protobuf::Message* message);

// Sets one field from text, as in "range_max_m=12"; adds to one that is repeated. InvalidArgument
// names the fields there are.
absl::Status SetCheckedField(const std::string& name, const std::string& value,
                             google::protobuf::Message* message);

// The fields that are set, none of them messages, with values as SetCheckedField() takes them.
std::vector<std::pair<std::string, std::string>> SetFields(
    const google::protobuf::Message& message);

// All fields with their documentation, default and range as comments. A field that is not set
// stands there as a comment with its default, so that the text parses to the same message.
std::string PrintDocumented(const google::protobuf::Message& message);

}  // namespace splinemap
