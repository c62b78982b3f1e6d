// SPDX-License-Identifier: Apache-2.0
// Private to lib/model: a JSON text as a document, read with suspicion. `parse` bounds what a file
// may hold at all; `Reader` is the cursor with which json.cc takes values out and refuses what is
// wrong with file, JSON pointer, value and cause. What a reader has asked for are the keys of the
// format; they are stated nowhere else. nlohmann's exceptions end here.
#pragma once

#include <cstdint>
#include <initializer_list>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include <nlohmann/json.hpp>

#include <xauto/result.h>

#include "model/keys.h"
#include "model/parameter.h"

namespace xauto::json_document {

/// Values (numbers, texts, arrays, objects, ...) in one file: bounds the memory of a parsed
/// document. The largest app (kMaxEdges) has about six million.
inline constexpr std::size_t kMaxValues = 8'000'000;

/// Refuses, on top of what is not JSON: too long, too deep, too many values, a key twice in one
/// object.
[[nodiscard]] Result<nlohmann::json> parse(std::string_view text, std::string_view origin);

/// For people: two spaces of indent, what fits into one line on one line; ends with a newline. Key
/// order is the document's.
[[nodiscard]] std::string to_text(const nlohmann::ordered_json& document);

/// One place of a format, all elements of an array being one: the keys that were asked for there. A
/// format may allow several kinds of value at one place.
struct Place {
  std::vector<std::pair<std::string, std::unique_ptr<Place>>> keys;
  std::unique_ptr<Place> element;  ///< of an array
  std::unique_ptr<Place> member;   ///< of an object whose keys the file chooses itself
  [[nodiscard]] Place* find(std::string_view key) const;  ///< null: nobody asked for it
  Place* at(std::string_view key);                        ///< asks for it
  Place* any_element();
  Place* any_member();
};

/// Cursor into a document. The first error sticks; reads after it give neutral values, so that the
/// code using it needs no check per key: it asks the context for its status once at the end.
class Reader {
 public:
  struct Context {
    std::string origin;
    std::optional<Error> error;
    Place root = {};
    [[nodiscard]] Status status() const;
    /// Of what was asked for until now.
    [[nodiscard]] Keys keys(const nlohmann::json& document) const;
  };

  Reader(Context& context, const nlohmann::json* value, std::string path)
      : Reader(context, value, std::move(path), &context.root) {}

  [[nodiscard]] bool failed() const { return context_.error.has_value(); }
  void refuse(std::string what, std::string hint = {}) const;

  /// There and not null: optional keys may be null.
  [[nodiscard]] bool has(const char* key) const;
  /// Keys that another reader of the same file takes: "chains/*/name", `*` for any element.
  void knows(std::initializer_list<std::string_view> paths) const;
  [[nodiscard]] Reader operator[](const char* key) const;

  /// each(index, Reader), of an array of at most `limit` elements.
  template <class Each>
  void each_element(std::size_t limit, Each each) const {
    if (!is_array(limit)) return;
    for (std::size_t i = 0; i < value_->size() && !failed(); ++i)
      each(i,
           Reader(context_, &(*value_)[i], path_ + "/" + std::to_string(i), place_->any_element()));
  }
  /// each(key, Reader), of an object of at most `limit` members, in the order of the keys' bytes.
  template <class Each>
  void each_member(std::size_t limit, Each each) const {
    if (!is_object(limit)) return;
    for (auto member = value_->begin(); member != value_->end() && !failed(); ++member)
      if (is_name(member.key()))
        each(member.key(), below(member.key(), &member.value(), place_->any_member()));
  }
  [[nodiscard]] bool is_text() const { return value_ != nullptr && value_->is_string(); }
  [[nodiscard]] bool is_object() const { return value_ != nullptr && value_->is_object(); }
  /// A name: valid UTF-8 (checked by the parser), at most kMaxNameBytes, no control characters.
  [[nodiscard]] std::string text() const;
  [[nodiscard]] bool boolean() const;
  [[nodiscard]] std::int64_t integer(std::int64_t low, std::int64_t high) const;
  [[nodiscard]] std::int64_t time() const;  ///< integer from 0 to kMaxTimeUs

  /// A boolean, a number or a text; an integer where it is written as one.
  [[nodiscard]] ParameterValue scalar() const;

  /// A number as the shortest decimal that means it, or a text as it is. Empty: refused.
  [[nodiscard]] std::string decimal() const;

  /// "schema" and "version": the file says what it is. `hint`: what to do with an older one.
  void expect(const char* schema, std::int64_t version = 1,
              std::string hint = "write the file again with this version") const;

 private:
  [[nodiscard]] bool is_array(std::size_t limit) const;
  [[nodiscard]] bool is_object(std::size_t limit) const;
  [[nodiscard]] bool is_name(const std::string& text) const;
  [[nodiscard]] Reader below(const std::string& key, const nlohmann::json* value,
                             Place* place) const;
  Reader(Context& context, const nlohmann::json* value, std::string path, Place* place)
      : context_(context), value_(value), path_(std::move(path)), place_(place) {}

  Context& context_;
  const nlohmann::json* value_;  ///< null after an error
  std::string path_;             ///< JSON pointer (RFC 6901)
  Place* place_;                 ///< where that is in the format
};

}  // namespace xauto::json_document
