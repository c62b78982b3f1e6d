// SPDX-License-Identifier: Apache-2.0
#include "import/yaml.h"

#include <yaml.h>

namespace xauto::import {
namespace {

class Parser {
 public:
  Parser(std::string_view text, const std::string& origin) : origin_(origin) {
    ready_ = yaml_parser_initialize(&parser_) != 0;
    if (ready_)
      yaml_parser_set_input_string(&parser_, reinterpret_cast<const unsigned char*>(text.data()),
                                   text.size());
  }
  ~Parser() {
    if (ready_) yaml_parser_delete(&parser_);
  }
  Parser(const Parser&) = delete;
  Parser& operator=(const Parser&) = delete;

  Result<Yaml> document() {
    if (!ready_) return fail(ErrorCode::kIo, "no memory", origin_);
    Yaml root;
    for (;;) {
      XAUTO_TRY(next());
      const yaml_event_type_t type = event_.type;
      if (type == YAML_STREAM_END_EVENT) return forget(), root;
      if (type == YAML_STREAM_START_EVENT || type == YAML_DOCUMENT_START_EVENT) {
        yaml_event_delete(&event_);
        continue;
      }
      XAUTO_TRY(node(root, 0));
      return root;
    }
  }

 private:
  void forget() { yaml_event_delete(&event_); }

  [[nodiscard]] tl::unexpected<Error> refuse(const std::string& what) {
    return fail(ErrorCode::kInvalid, what,
                origin_ + ", line " + std::to_string(parser_.mark.line + 1));
  }

  Status next() {
    if (yaml_parser_parse(&parser_, &event_) != 0) return {};
    return refuse(parser_.problem == nullptr ? "no YAML"
                                             : std::string("no YAML: ") + parser_.problem);
  }

  /// Of the event that is there, which it deletes.
  Status node(Yaml& into, int depth) {
    const yaml_event_type_t type = event_.type;
    if (type == YAML_SCALAR_EVENT)
      into.text.assign(reinterpret_cast<const char*>(event_.data.scalar.value),
                       event_.data.scalar.length);
    forget();
    if (++nodes_ > kMaxYamlNodes) return refuse("more than 1000000 values");
    if (depth > kMaxYamlDepth) return refuse("more than 32 levels");
    if (type == YAML_SCALAR_EVENT) return {};
    if (type == YAML_SEQUENCE_START_EVENT) return sequence(into, depth);
    if (type == YAML_MAPPING_START_EVENT) return mapping(into, depth);
    return refuse("an alias is not read here");
  }

  Status sequence(Yaml& into, int depth) {
    for (;;) {
      XAUTO_TRY(next());
      if (event_.type == YAML_SEQUENCE_END_EVENT) return forget(), Status();
      XAUTO_TRY(node(into.list.emplace_back(), depth + 1));
    }
  }

  Status mapping(Yaml& into, int depth) {
    for (;;) {
      XAUTO_TRY(next());
      if (event_.type == YAML_MAPPING_END_EVENT) return forget(), Status();
      Yaml key;
      const bool text = event_.type == YAML_SCALAR_EVENT;
      XAUTO_TRY(node(key, depth + 1));
      if (!text) return refuse("a key that is no text");
      XAUTO_TRY(next());
      into.keys.push_back(std::move(key.text));
      XAUTO_TRY(node(into.values.emplace_back(), depth + 1));
    }
  }

  const std::string& origin_;
  yaml_parser_t parser_ = {};
  yaml_event_t event_ = {};
  bool ready_ = false;
  std::size_t nodes_ = 0;
};

}  // namespace

Result<Yaml> parse_yaml(std::string_view text, const std::string& origin) {
  return Parser(text, origin).document();
}

}  // namespace xauto::import
