// SPDX-License-Identifier: Apache-2.0
// Private to lib/model: what several formats have in common.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <unordered_map>
#include <utility>
#include <vector>

#include <xauto/result.h>

#include "model/app.h"
#include "model/json_document.h"

namespace xauto::json_parts {

using json_document::Reader;
using nlohmann::ordered_json;

/// Puts the file's name before the place that a validator names.
[[nodiscard]] Status in_file(Status status, std::string_view origin);
/// A validator counts XNodes as the app does; the file may list them in another order.
[[nodiscard]] Status in_file_order(Error error, const std::string& list,
                                   const std::vector<std::size_t>& line_of);

using NameIndex = std::unordered_map<std::string, int>;
template <class Named>
NameIndex index_by_name(const std::vector<Named>& list) {
  NameIndex index;
  for (std::size_t i = 0; i < list.size(); ++i)
    index.try_emplace(list[i].name, static_cast<int>(i));
  return index;
}

/// The index of a name, "XNode" or whatever `what` it is; -1: refused.
[[nodiscard]] int read_name(const Reader& name, const NameIndex& index, const char* what,
                            const char* list);
/// ["u", "v"] by XNode name.
[[nodiscard]] std::pair<int, int> read_pair(const Reader& pair, const NameIndex& index);
/// [["u", "v"], ...]
[[nodiscard]] std::vector<std::pair<int, int>> read_pairs(const Reader& reader,
                                                          const NameIndex& index,
                                                          std::size_t limit = kMaxEdges);

/// "chains" of `x`, each chain of the app once, in any order: each(chain, its line). `kept`: [chain]
/// whether it is one of them; all are without it.
template <class Each>
void each_chain(const Reader& x, const AppSpec& app, Each each, std::vector<char> kept = {}) {
  const NameIndex index = index_by_name(app.chains);
  std::vector<char> there(app.chains.size(), 0);
  kept.resize(app.chains.size(), kept.empty() ? 1 : 0);
  x["chains"].each_element(kMaxAppChains, [&](std::size_t, const Reader& c) {
    const int found = read_name(c["name"], index, "chain", "the app");
    if (c.failed()) return;
    const auto k = static_cast<std::size_t>(found);
    if (there[k]) return c["name"].refuse("chain '" + app.chains[k].name + "' is there twice");
    if (!kept[k])
      return c["name"].refuse("a module on the way of chain '" + app.chains[k].name + "' is off");
    there[k] = 1;
    each(k, c);
  });
  if (x.failed()) return;
  for (std::size_t k = 0; k < there.size(); ++k)
    if (kept[k] && !there[k])
      return x["chains"].refuse("chain '" + app.chains[k].name + "' is missing");
}

/// Times by activation, in microseconds; empty where the key is not required and not there.
[[nodiscard]] std::vector<std::int64_t> read_series(const Reader& reader, const char* key,
                                                    bool required);

/// "period_us" or "rate_hz", exactly one of them.
[[nodiscard]] Period read_period(const Reader& source);
void write_period(const Period& period, ordered_json& source);
/// "source" of an XNode: a name, or an array of names.
[[nodiscard]] std::vector<int> read_heard(const Reader& xnode, const NameIndex& sources);

void write_heard(const std::vector<int>& heard, const std::vector<SourceSpec>& sources,
                 ordered_json& xnode);

template <class Names>
ordered_json pairs_to_json(const std::vector<std::pair<int, int>>& pairs, const Names& name) {
  ordered_json out = ordered_json::array();
  for (const auto& [u, v] : pairs) out.push_back({name(u), name(v)});
  return out;
}

}  // namespace xauto::json_parts
