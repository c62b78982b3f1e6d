// SPDX-License-Identifier: Apache-2.0
#include "model/json_value.h"

#include <algorithm>

#include <nlohmann/json.hpp>

#include "model/json.h"

namespace xauto {

using nlohmann::ordered_json;

/// Between our values and nlohmann's texts.
struct JsonCodec {
  using Kind = Json::Kind;

  static ordered_json to_document(const Json& value) {
    switch (value.kind_) {
      case Kind::kNull:
        return {};
      case Kind::kBoolean:
        return value.boolean_;
      case Kind::kSigned:
        return value.signed_;
      case Kind::kUnsigned:
        return value.unsigned_;
      case Kind::kReal:
        return value.real_;
      case Kind::kText:
        return value.text_;
      case Kind::kArray: {
        ordered_json out = ordered_json::array();
        for (const Json& element : value.elements_) out.push_back(to_document(element));
        return out;
      }
      case Kind::kObject:
        break;
    }
    ordered_json out = ordered_json::object();
    for (std::size_t i = 0; i < value.keys_.size(); ++i)
      out[value.keys_[i]] = to_document(value.elements_[i]);
    return out;
  }
};

namespace {

/// Builds a value from the parser's events, without recursion.
class Builder : public nlohmann::json_sax<ordered_json> {
 public:
  Json root;

  bool null() override { return put({}); }
  bool boolean(bool value) override { return put(value); }
  bool number_integer(number_integer_t value) override { return put(value); }
  bool number_unsigned(number_unsigned_t value) override { return put(value); }
  bool number_float(number_float_t value, const string_t&) override { return put(value); }
  bool string(string_t& value) override { return put(std::move(value)); }
  bool binary(binary_t&) override { return false; }
  bool start_object(std::size_t) override { return open(Json::object()); }
  bool start_array(std::size_t) override { return open(Json::array()); }
  bool end_object() override { return close(); }
  bool end_array() override { return close(); }
  bool key(string_t& key) override {
    key_ = std::move(key);
    return true;
  }
  bool parse_error(std::size_t, const std::string&, const nlohmann::detail::exception&) override {
    return false;
  }

 private:
  Json* place(Json value) {
    if (open_.empty()) {
      root = std::move(value);
      return &root;
    }
    Json& in = *open_.back();
    if (in.is_object()) return &(in[key_] = std::move(value));
    in.push_back(std::move(value));
    return &in.elements().back();
  }
  bool put(Json value) {
    place(std::move(value));
    return true;
  }
  bool open(Json value) {
    if (open_.size() >= static_cast<std::size_t>(kMaxJsonDepth)) return false;
    open_.push_back(place(std::move(value)));
    return true;
  }
  bool close() {
    open_.pop_back();
    return true;
  }

  /// Those that are being read. Nothing is added to one of them while a later one is open, so
  /// that the addresses stay.
  std::vector<Json*> open_;
  std::string key_;
};

}  // namespace

Json::Json(std::initializer_list<NamedValue> members) : kind_(Kind::kObject) {
  for (const NamedValue& member : members) (*this)[member.key] = member.value;
}

Json Json::array(std::initializer_list<Json> elements) {
  Json value;
  value.kind_ = Kind::kArray;
  value.elements_ = elements;
  return value;
}

Json Json::object() {
  Json value;
  value.kind_ = Kind::kObject;
  return value;
}

std::optional<Json> Json::parse(std::string_view text) {
  Builder builder;
  if (!ordered_json::sax_parse(text.begin(), text.end(), &builder)) return std::nullopt;
  return std::move(builder.root);
}

void Json::set(bool value) {
  kind_ = Kind::kBoolean;
  boolean_ = value;
}

void Json::set(std::int64_t value) {
  kind_ = Kind::kSigned;
  signed_ = value;
}

void Json::set(std::uint64_t value) {
  kind_ = Kind::kUnsigned;
  unsigned_ = value;
}

void Json::set(double value) {
  kind_ = Kind::kReal;
  real_ = value;
}

Json& Json::operator[](const std::string& key) {
  if (is_null()) kind_ = Kind::kObject;
  if (Json* known = find(key)) return *known;
  keys_.push_back(key);
  return elements_.emplace_back();
}

void Json::push_back(Json element) {
  if (is_null()) kind_ = Kind::kArray;
  elements_.push_back(std::move(element));
}

std::optional<bool> Json::boolean() const {
  return kind_ == Kind::kBoolean ? std::optional(boolean_) : std::nullopt;
}

std::optional<std::int64_t> Json::integer() const {
  if (kind_ == Kind::kSigned) return signed_;
  if (kind_ == Kind::kUnsigned && unsigned_ <= INT64_MAX)
    return static_cast<std::int64_t>(unsigned_);
  return std::nullopt;
}

std::optional<double> Json::number() const {
  if (kind_ == Kind::kSigned) return static_cast<double>(signed_);
  if (kind_ == Kind::kUnsigned) return static_cast<double>(unsigned_);
  return kind_ == Kind::kReal ? std::optional(real_) : std::nullopt;
}

std::optional<std::string> Json::text() const {
  return kind_ == Kind::kText ? std::optional(text_) : std::nullopt;
}

Json* Json::find(std::string_view key) {
  const auto at = std::find(keys_.begin(), keys_.end(), key);
  return at == keys_.end() ? nullptr : &elements_[static_cast<std::size_t>(at - keys_.begin())];
}

const Json* Json::find(std::string_view key) const {
  return const_cast<Json*>(this)->find(key);
}

const Json& Json::at(std::string_view key) const {
  static const Json kNothing{};
  const Json* found = find(key);
  return found != nullptr ? *found : kNothing;
}

std::string Json::dump(int indent) const {
  return JsonCodec::to_document(*this).dump(indent, ' ', false,
                                            ordered_json::error_handler_t::replace);
}

}  // namespace xauto
