// SPDX-License-Identifier: Apache-2.0
#include "import/answers.h"

#include <algorithm>
#include <charconv>
#include <optional>
#include <utility>
#include <vector>

#include "model/json_value.h"

namespace xauto::import {
namespace {

/// The parts of a JSON pointer without escapes: those of our own TODOs have none.
std::vector<std::string> parts_of(const std::string& pointer) {
  std::vector<std::string> parts;
  for (std::size_t from = 1; from <= pointer.size();) {
    const std::size_t slash = std::min(pointer.find('/', from), pointer.size());
    parts.push_back(pointer.substr(from, slash - from));
    from = slash + 1;
  }
  return parts;
}

Json* member(Json& of, const std::string& part) {
  if (!of.is_array()) return &of[part];
  std::size_t index = 0;
  const auto [end, error] = std::from_chars(part.data(), part.data() + part.size(), index);
  if (error != std::errc() || end != part.data() + part.size() || index >= of.elements().size())
    return nullptr;
  return &of.elements()[index];
}

void put(Json& place, Json answer) {
  if (!place.is_object() || !answer.is_object()) {
    place = std::move(answer);
    return;
  }
  for (std::size_t m = 0; m < answer.keys().size(); ++m)
    place[answer.keys()[m]] = answer.elements()[m];
}

}  // namespace

Result<ImportedApp> with_answer(const ImportedApp& imported, std::size_t todo,
                                const std::string& answer) {
  ImportedApp changed = imported;
  const std::string pointer = changed.todo.at(todo).at;
  changed.todo.erase(changed.todo.begin() + static_cast<std::ptrdiff_t>(todo));
  std::optional<Json> document = Json::parse(to_json(changed));
  std::vector<std::string> parts = parts_of(pointer);
  if (!document || parts.empty())
    return fail(ErrorCode::kInvalid, "has no place in the file", "TODO " + std::to_string(todo),
                "change the file by hand");
  const std::string last = parts.back();
  parts.pop_back();
  Json* place = &*document;
  for (const std::string& part : parts)
    if (place = member(*place, part); place == nullptr)
      return fail(ErrorCode::kInvalid, "is no place in the file", pointer);
  std::optional<Json> value = Json::parse(answer);
  if (!value) value = Json(answer);
  if (last == "-" && (place->is_array() || place->is_null())) {
    place->push_back(std::move(*value));
  } else {
    Json* const at = member(*place, last);
    if (at == nullptr) return fail(ErrorCode::kInvalid, "is no place in the file", pointer);
    put(*at, std::move(*value));
  }
  return parse_imported(document->dump(2), "the answer");
}

}  // namespace xauto::import
