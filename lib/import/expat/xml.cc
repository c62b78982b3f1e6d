// SPDX-License-Identifier: Apache-2.0
#include "import/xml.h"

#include <algorithm>
#include <memory>

#include <expat.h>

namespace xauto::import {
namespace {

struct Building {
  XML_Parser parser = nullptr;
  Xml root;
  std::vector<Xml*> open;  ///< its parents' vectors grow only while it is closed
  std::size_t elements = 0;
  const char* refused = nullptr;

  void refuse(const char* why) {
    if (refused == nullptr) refused = why;
    XML_StopParser(parser, XML_FALSE);
  }
};

void on_start(void* user, const XML_Char* name, const XML_Char** attributes) {
  auto& b = *static_cast<Building*>(user);
  if (b.refused != nullptr) return;
  if (b.open.size() >= static_cast<std::size_t>(kMaxXmlDepth))
    return b.refuse("is nested too deep");
  if (++b.elements > kMaxXmlElements) return b.refuse("has more than 4000000 elements");
  Xml* element = &b.root;
  if (!b.open.empty()) element = &b.open.back()->children.emplace_back();
  element->name = name;
  for (; *attributes != nullptr; attributes += 2) {
    if (element->attributes.size() >= kMaxXmlAttributes)
      return b.refuse("has an element of more than 64 attributes");
    element->attributes.emplace_back(attributes[0], attributes[1]);
  }
  b.open.push_back(element);
}

void on_end(void* user, const XML_Char* /*name*/) {
  auto& b = *static_cast<Building*>(user);
  if (b.refused == nullptr && !b.open.empty()) b.open.pop_back();
}

void on_doctype(void* user, const XML_Char*, const XML_Char*, const XML_Char*, int) {
  static_cast<Building*>(user)->refuse("has a DOCTYPE, which no model needs");
}

}  // namespace

Result<Xml> parse_xml(std::string_view text, const std::string& origin) {
  if (text.size() > kMaxXmlBytes)
    return fail(ErrorCode::kInvalid, "is larger than 256 MiB", origin, "cut it");
  Building building;
  const std::unique_ptr<XML_ParserStruct, void (*)(XML_Parser)> parser(XML_ParserCreate(nullptr),
                                                                       XML_ParserFree);
  building.parser = parser.get();
  XML_SetUserData(parser.get(), &building);
  XML_SetElementHandler(parser.get(), on_start, on_end);
  XML_SetStartDoctypeDeclHandler(parser.get(), on_doctype);
  constexpr std::size_t kPiece = 1u << 20;
  for (std::size_t from = 0; from == 0 || from < text.size(); from += kPiece) {
    const std::string_view piece = text.substr(from, kPiece);
    const bool last = from + kPiece >= text.size();
    if (XML_Parse(parser.get(), piece.data(), static_cast<int>(piece.size()), last ? 1 : 0) ==
        XML_STATUS_OK)
      continue;
    const std::string what =
        building.refused != nullptr
            ? building.refused
            : std::string("is no XML: ") + XML_ErrorString(XML_GetErrorCode(parser.get()));
    return fail(ErrorCode::kInvalid, what,
                origin + ", line " + std::to_string(XML_GetCurrentLineNumber(parser.get())));
  }
  return std::move(building.root);
}

}  // namespace xauto::import
