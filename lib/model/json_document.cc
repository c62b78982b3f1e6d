// SPDX-License-Identifier: Apache-2.0
#include "model/json_document.h"

#include <algorithm>
#include <array>
#include <string_view>
#include <vector>

#include "base/nearest.h"
#include "base/number.h"
#include "model/app.h"
#include "model/json.h"

namespace xauto::json_document {
namespace {

/// Where a file of this schema goes; empty: nobody knows it.
std::string where_read(std::string_view schema) {
  static constexpr std::array<std::array<std::string_view, 2>, 8> kRead = {{
      {"xauto.app", "--app"},
      {"xauto.platform", "--platform"},
      {"xauto.policy", "--policy"},
      {"xauto.tables", "--policy of check and run"},
      {"xauto.scenarios", "--scenarios of solve"},
      {"xauto.profile", "profile --merge"},
      {"xauto.emulation", "--emulate-script"},
      {"xauto.deployment", "--deployment"},
  }};
  for (const auto& [name, option] : kRead)
    if (name == schema)
      return " A file of " + std::string(schema) + " goes to " + std::string(option);
  return {};
}

using nlohmann::json;
using nlohmann::ordered_json;

constexpr std::size_t kMaxShown = 60;    // bytes of a value or key that a message repeats
constexpr std::size_t kLineWidth = 100;  // of files that we write

/// `text` as it may stand in a message: cut, control characters and quotes escaped, ASCII.
std::string shown(const std::string& text) {
  std::string quoted =
      json(text.substr(0, kMaxShown)).dump(-1, ' ', true, json::error_handler_t::replace);
  if (text.size() > kMaxShown) quoted = quoted.substr(0, quoted.size() - 1) + "...\"";
  return quoted;
}

std::string shown(const json& value) {
  if (value.is_string()) return shown(value.get_ref<const std::string&>());
  if (value.is_object()) return "an object";
  if (value.is_array()) return "an array";
  return value.dump();
}

/// One step of a JSON pointer (RFC 6901), cut if it is endless.
std::string step(const std::string& key) {
  std::string escaped;
  for (const char c : key.substr(0, kMaxShown)) {
    if (c == '~')
      escaped += "~0";
    else if (c == '/')
      escaped += "~1";
    else
      escaped += static_cast<unsigned char>(c) < 0x20 || c == 0x7f ? '?' : c;
  }
  // A cut may have gone through a character of several bytes: drop what is left of it.
  if (key.size() > kMaxShown) {
    while (!escaped.empty() && (static_cast<unsigned char>(escaped.back()) & 0xc0) == 0x80)
      escaped.pop_back();
    if (!escaped.empty() && (static_cast<unsigned char>(escaped.back()) & 0x80) != 0)
      escaped.pop_back();
    escaped += "...";
  }
  return "/" + escaped;
}

/// nlohmann's "[json.exception.parse_error.101] parse error at line 3, column 7: syntax error while
/// …; last read: '…'" without its own name and without repeating a token of any length or encoding.
std::string explain(std::string what) {
  if (const std::size_t line = what.find("at line"); line != std::string::npos)
    what = "is not JSON " + what.substr(line);
  else if (const std::size_t bracket = what.find("] "); bracket != std::string::npos)
    what = "is not JSON: " + what.substr(bracket + 2);
  const bool plain =
      std::all_of(what.begin(), what.end(), [](unsigned char c) { return c >= 0x20 && c < 0x7f; });
  if (const std::size_t token = what.find("; last read: "); token != std::string::npos) {
    const std::size_t expected = what.rfind("; expected ");
    const std::string tail =
        expected != std::string::npos && expected > token ? what.substr(expected) : "";
    if (!plain || what.size() - token - tail.size() > kMaxShown)
      what = what.substr(0, token) + tail;
  }
  for (char& c : what)
    if (static_cast<unsigned char>(c) < 0x20 || static_cast<unsigned char>(c) >= 0x7f) c = '?';
  if (what.size() > 300) what = what.substr(0, 297) + "...";
  return what;
}

/// Builds a document, and refuses what nlohmann's own parser lets pass. That one's callback would do,
/// but it looks at all elements of a list again after each object in it.
class Builder : public nlohmann::json_sax<json> {
 public:
  struct Refusal {
    std::string what, path;
  };

  bool null() override { return add(nullptr); }
  bool boolean(bool value) override { return add(value); }
  bool number_integer(number_integer_t value) override { return add(value); }
  bool number_unsigned(number_unsigned_t value) override { return add(value); }
  bool number_float(number_float_t value, const string_t& /*text*/) override { return add(value); }
  bool string(string_t& value) override { return add(std::move(value)); }
  bool binary(binary_t& value) override { return add(std::move(value)); }
  bool start_object(std::size_t /*size*/) override { return open(json::object()); }
  bool start_array(std::size_t /*size*/) override { return open(json::array()); }
  bool end_object() override { return close(); }
  bool end_array() override { return close(); }
  bool key(string_t& key) override {
    Frame& frame = frames_.back();
    if (frame.value->contains(key)) throw Refusal{"key " + shown(key) + " is there twice", path()};
    frame.key = std::move(key);
    return true;
  }
  bool parse_error(std::size_t /*position*/, const std::string& /*token*/,
                   const json::exception& e) override {
    // Of what is no JSON it knows line and column.
    const bool knows = dynamic_cast<const json::parse_error*>(&e) != nullptr;
    throw Refusal{explain(e.what()), knows ? "" : path()};
  }

  /// JSON pointer of what is being read.
  [[nodiscard]] std::string path() const {
    std::string text;
    for (const Frame& frame : frames_) {
      if (frame.value->is_array())  // what is open is in it already
        text += "/" + std::to_string(frame.value->size() - (&frame == &frames_.back() ? 0 : 1));
      else if (!frame.key.empty())
        text += step(frame.key);
    }
    return text;
  }

  json document;

 private:
  /// An array or object that is open. Nothing around it grows before it is closed.
  struct Frame {
    json* value;
    std::string key;  // of the object member being read
  };

  json* put(json value) {
    if (++values_ > kMaxValues)
      throw Refusal{"has more than " + std::to_string(kMaxValues) + " values", {}};
    if (frames_.empty()) return &(document = std::move(value));
    Frame& frame = frames_.back();
    if (!frame.value->is_array()) return &((*frame.value)[frame.key] = std::move(value));
    frame.value->push_back(std::move(value));
    return &frame.value->back();
  }
  bool add(json value) {
    put(std::move(value));
    if (!frames_.empty()) frames_.back().key.clear();
    return true;
  }
  bool open(json value) {
    if (frames_.size() >= static_cast<std::size_t>(kMaxJsonDepth))
      throw Refusal{"is nested deeper than " + std::to_string(kMaxJsonDepth), path()};
    frames_.push_back({put(std::move(value)), {}});
    return true;
  }
  bool close() {
    frames_.pop_back();
    if (!frames_.empty()) frames_.back().key.clear();
    return true;
  }

  std::vector<Frame> frames_;
  std::size_t values_ = 0;
};

std::string place(const std::string& origin, const std::string& path) {
  return path.empty() ? origin : origin + ": " + path;
}

// ---- keys that nobody asked for ----

/// Whether there is an object with keys of ours at the place or below.
bool has_keys(const Place& place) {
  return !place.keys.empty() || (place.element && has_keys(*place.element)) ||
         (place.member && has_keys(*place.member));
}

void list_known(const Place& place, const std::string& path, std::vector<std::string>& known) {
  for (const auto& [key, below] : place.keys) {
    const std::string here = path + "/" + key;
    known.push_back(here);
    list_known(*below, here, known);
  }
  for (const Place* any : {place.element.get(), place.member.get()})
    if (any != nullptr) list_known(*any, path + "/*", known);
}

/// The key of ours that was most probably meant.
std::string nearest_key(const Place& place, const std::string& given) {
  std::vector<std::string> keys;
  for (const auto& [key, below] : place.keys) keys.push_back(key);
  return nearest(given, keys);
}

void list_unknown(const json& value, const Place& place, const std::string& path,
                  std::vector<Keys::Unknown>& unknown) {
  if (!has_keys(place)) return;
  if (value.is_array() && place.element)
    for (std::size_t i = 0; i < value.size(); ++i)
      list_unknown(value[i], *place.element, path + "/" + std::to_string(i), unknown);
  if (!value.is_object()) return;
  for (auto member = value.begin(); member != value.end(); ++member) {
    const std::string& key = member.key();
    if (const Place* below = place.member ? place.member.get() : place.find(key))
      list_unknown(*member, *below, path + step(key), unknown);
    else if (!key.starts_with(kOthersKeys))
      unknown.push_back({path + step(key), nearest_key(place, key)});
  }
}

// ---- writing ----

std::string one_line(const ordered_json& value) {
  if (!value.is_structured())
    return value.dump(-1, ' ', false, ordered_json::error_handler_t::replace);
  if (value.empty()) return value.is_object() ? "{}" : "[]";
  std::string text = value.is_object() ? "{ " : "[";
  bool first = true;
  for (auto item = value.begin(); item != value.end(); ++item) {
    if (!first) text += ", ";
    first = false;
    if (value.is_object()) text += one_line(ordered_json(item.key())) + ": ";
    text += one_line(*item);
  }
  return text + (value.is_object() ? " }" : "]");
}

void write(std::string& out, const ordered_json& value, std::size_t indent, bool top) {
  // The elements of a list of structures get a line each, however short: diffs stay readable.
  const bool list = value.is_array() && !value.empty() && value.front().is_structured();
  if (!value.is_structured() || (!top && !list)) {
    const std::string line = one_line(value);
    if (!value.is_structured() || indent + line.size() <= kLineWidth) {
      out += line;
      return;
    }
  }
  out += value.is_object() ? "{" : "[";
  bool first = true;
  for (auto item = value.begin(); item != value.end(); ++item) {
    out += first ? "\n" : ",\n";
    first = false;
    out.append(indent + 2, ' ');
    if (value.is_object()) out += one_line(ordered_json(item.key())) + ": ";
    write(out, *item, indent + 2, false);
  }
  if (!first) out.append("\n").append(indent, ' ');
  out += value.is_object() ? "}" : "]";
}

}  // namespace

Result<json> parse(std::string_view text, std::string_view origin) {
  if (text.size() > kMaxFileBytes)
    return fail(ErrorCode::kInvalid, "is longer than " + std::to_string(kMaxFileBytes) + " bytes",
                std::string(origin));
  Builder builder;
  try {
    (void)json::sax_parse(text.begin(), text.end(), &builder);
    return std::move(builder.document);
  } catch (const Builder::Refusal& refusal) {
    return fail(ErrorCode::kInvalid, refusal.what, place(std::string(origin), refusal.path));
  } catch (const std::exception& e) {
    return fail(ErrorCode::kInvalid, explain(e.what()), place(std::string(origin), builder.path()));
  }
}

std::string to_text(const ordered_json& document) {
  std::string out;
  write(out, document, 0, true);
  return out + "\n";
}

// ---- Reader ----

Status Reader::Context::status() const {
  if (error) return tl::unexpected<Error>(*error);
  return {};
}

void Reader::refuse(std::string what, std::string hint) const {
  if (failed()) return;
  context_.error =
      Error{ErrorCode::kInvalid, std::move(what), place(context_.origin, path_), std::move(hint)};
}

Place* Place::find(std::string_view key) const {
  for (const auto& [name, place] : keys)
    if (name == key) return place.get();
  return nullptr;
}

Place* Place::at(std::string_view key) {
  if (Place* known = find(key)) return known;
  return keys.emplace_back(key, std::make_unique<Place>()).second.get();
}

Place* Place::any_element() {
  if (!element) element = std::make_unique<Place>();
  return element.get();
}

Place* Place::any_member() {
  if (!member) member = std::make_unique<Place>();
  return member.get();
}

Keys Reader::Context::keys(const json& document) const {
  Keys keys;
  list_known(root, "", keys.known);
  list_unknown(document, root, "", keys.unknown);
  return keys;
}

void Reader::knows(std::initializer_list<std::string_view> paths) const {
  for (std::string_view path : paths) {
    Place* place = place_;
    for (std::size_t end = 0; end != std::string_view::npos; path.remove_prefix(end + 1)) {
      end = path.find('/');
      const std::string_view key = path.substr(0, end);
      place = key == "*" ? place->any_element() : place->at(key);
      if (end == std::string_view::npos) break;
    }
  }
}

bool Reader::has(const char* key) const {
  place_->at(key);
  if (value_ == nullptr || !value_->is_object()) return false;
  const auto found = value_->find(key);
  return found != value_->end() && !found->is_null();
}

Reader Reader::operator[](const char* key) const {
  const json* found = nullptr;
  if (value_ != nullptr && !value_->is_object()) {
    refuse("must be an object, is " + shown(*value_));
  } else if (value_ != nullptr) {
    const auto member = value_->find(key);
    if (member == value_->end())
      refuse("key \"" + std::string(key) + "\" is missing");
    else
      found = &*member;
  }
  // Where the file names its members itself, one of them is as good as any other.
  return below(key, failed() ? nullptr : found,
               place_->member ? place_->any_member() : place_->at(key));
}

Reader Reader::below(const std::string& key, const json* value, Place* place) const {
  return {context_, value, path_ + step(key), place};
}

bool Reader::is_array(std::size_t limit) const {
  if (value_ == nullptr) return false;
  if (!value_->is_array())
    refuse("must be an array, is " + shown(*value_));
  else if (value_->size() > limit)
    refuse("has " + std::to_string(value_->size()) + " elements, at most " + std::to_string(limit) +
           " are possible");
  return !failed();
}

bool Reader::is_object(std::size_t limit) const {
  if (value_ == nullptr) return false;
  if (!value_->is_object())
    refuse("must be an object, is " + shown(*value_));
  else if (value_->size() > limit)
    refuse("has " + std::to_string(value_->size()) + " members, at most " + std::to_string(limit) +
           " are possible");
  return !failed();
}

bool Reader::is_name(const std::string& text) const {
  if (const std::string fault = fault_of_name(text); !fault.empty())
    refuse("name " + shown(text) + " " + fault);
  return !failed();
}

std::string Reader::text() const {
  if (value_ == nullptr) return {};
  if (!value_->is_string()) {
    refuse("must be a string, is " + shown(*value_));
    return {};
  }
  const auto& string = value_->get_ref<const std::string&>();
  return is_name(string) ? string : std::string();
}

bool Reader::boolean() const {
  if (value_ == nullptr) return false;
  if (!value_->is_boolean()) {
    refuse("must be true or false, is " + shown(*value_));
    return false;
  }
  return value_->get<bool>();
}

std::int64_t Reader::integer(std::int64_t low, std::int64_t high) const {
  if (value_ == nullptr) return low;
  const bool fits = value_->is_number_unsigned()
                        ? value_->get<std::uint64_t>() <= static_cast<std::uint64_t>(INT64_MAX)
                        : value_->is_number_integer();
  if (fits) {
    const auto number = value_->get<std::int64_t>();
    if (number >= low && number <= high) return number;
  }
  refuse("must be an integer from " + std::to_string(low) + " to " + std::to_string(high) +
         ", is " + shown(*value_));
  return low;
}

std::int64_t Reader::time() const {
  return integer(0, kMaxTimeUs);
}

ParameterValue Reader::scalar() const {
  if (value_ == nullptr) return false;
  if (value_->is_boolean()) return value_->get<bool>();
  if (value_->is_string()) return text();
  if (value_->is_number_float()) return value_->get<double>();
  if (value_->is_number_integer()) return integer(INT64_MIN, INT64_MAX);
  refuse("must be true, false, a number or a string, is " + shown(*value_));
  return false;
}

std::string Reader::decimal() const {
  if (value_ == nullptr) return {};
  if (value_->is_string()) return text();
  std::string digits;
  if (value_->is_number_unsigned())
    digits = std::to_string(value_->get<std::uint64_t>());
  else if (value_->is_number_integer())
    digits = std::to_string(value_->get<std::int64_t>());
  else if (value_->is_number_float())
    digits = decimal_of(value_->get<double>());
  if (!digits.empty()) return digits;
  refuse("must be a number of less than 64 digits, is " + shown(*value_));
  return {};
}

void Reader::expect(const char* schema, std::int64_t version, std::string hint) const {
  const Reader given = (*this)["schema"];
  const std::string name = given.text();
  if (!failed() && name != schema)
    given.refuse("is " + shown(name) + ", expected \"" + schema + "\"",
                 "is this the right file?" + where_read(name));
  const Reader said = (*this)["version"];
  const std::int64_t number = said.integer(0, INT32_MAX);
  if (!failed() && number != version)
    said.refuse(
        "is " + std::to_string(number) + ", this program reads version " + std::to_string(version),
        number > version ? "update xauto, or write the file again with this version"
                         : std::move(hint));
}

}  // namespace xauto::json_document
