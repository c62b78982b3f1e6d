// SPDX-License-Identifier: Apache-2.0
#include "model/asked.h"

#include <algorithm>
#include <set>
#include <utility>

#include "model/json.h"
#include "model/json_parts.h"

namespace xauto {
namespace {

using json_parts::ordered_json;

/// Keeps what is asked of one part of the app after the other. Names are matched, not places.
class Keeper {
 public:
  Keeper(AppSpec& app, const AppSpec& old, std::vector<std::string>& lines)
      : app_(app), old_(old), lines_(lines) {}

  /// Rates or none: of all sources the same, and the file's go before the program's.
  Status rates() {
    if (app_.one_at_a_time == old_.one_at_a_time) return {};
    for (const SourceSpec& source : app_.sources)
      if (std::none_of(old_.sources.begin(), old_.sources.end(),
                       [&](const SourceSpec& s) { return s.name == source.name; }))
        return fail(ErrorCode::kInvalid,
                    "source '" + source.name + "' is new, and the program gives it " +
                        (old_.one_at_a_time ? "a rate: no source in the file has one"
                                            : "no rate: the sources in the file have one"));
    lines_.emplace_back(old_.one_at_a_time ? "kept: no source has a rate (the program gives rates)"
                                           : "kept: the sources' rates (the program gives none)");
    app_.one_at_a_time = old_.one_at_a_time;
    rates_differ_ = true;
    return {};
  }

  void sources() {
    app_.clocks = old_.clocks;
    for (const SourceSpec& asked : old_.sources) {
      const auto at = std::find_if(app_.sources.begin(), app_.sources.end(),
                                   [&](const SourceSpec& s) { return s.name == asked.name; });
      if (at == app_.sources.end()) {
        lines_.push_back("left: source '" + asked.name + "', which the program does not have");
        continue;
      }
      SourceSpec kept = asked;
      if (asked.period != at->period && !rates_differ_)
        lines_.push_back("kept: source '" + asked.name + "': " + asked.period.text() +
                         " (the program says " + at->period.text() + ")");
      // A measured jitter is only ever the longest that was seen: so is one that was asked for.
      kept.jitter_us = app_.one_at_a_time ? 0 : std::max(asked.jitter_us, at->jitter_us);
      if (asked.jitter_us > at->jitter_us)
        lines_.push_back("kept: source '" + asked.name + "': jitter_us " +
                         std::to_string(asked.jitter_us) +
                         " (now measured: " + std::to_string(at->jitter_us) + ")");
      if (asked.offset_us != 0 || asked.clock != 0 || asked.urgent)
        lines_.push_back("kept: source '" + asked.name +
                         "': its offset, clock and urgent releases");
      *at = std::move(kept);
    }
  }

  void modules() {
    for (const ModuleSpec& asked : old_.modules) {
      const auto at = std::find_if(app_.modules.begin(), app_.modules.end(),
                                   [&](const ModuleSpec& m) { return m.name == asked.name; });
      if (at == app_.modules.end()) {
        if (asked != ModuleSpec{asked.name})
          lines_.push_back("left: module '" + asked.name + "', of which the program asks nothing");
      } else if (*at != asked) {
        lines_.push_back("kept: module '" + asked.name + "': max_in_flight " +
                         std::to_string(asked.max_in_flight) +
                         (asked.optional ? ", optional" : ", not optional") +
                         (asked.host.empty() ? "" : ", host '" + asked.host + "'"));
        *at = asked;
      }
    }
  }

  void chains() {
    std::vector<ChainSpec> kept;
    for (ChainSpec asked : old_.chains) {
      const std::string &from = old_.sources[static_cast<std::size_t>(asked.from)].name,
                        &to = old_.xnodes[static_cast<std::size_t>(asked.to)].name;
      const auto source = std::find_if(app_.sources.begin(), app_.sources.end(),
                                       [&](const SourceSpec& s) { return s.name == from; });
      const int xnode = app_.find(to);
      if (source == app_.sources.end() || xnode < 0) {
        lines_.push_back("left: chain '" + asked.name + "' from '" + from + "' to '" + to + "'");
        continue;
      }
      asked.from = static_cast<int>(source - app_.sources.begin());
      asked.to = xnode;
      for (const ChainSpec& fresh : app_.chains)
        if (fresh.from == asked.from && fresh.to == asked.to)
          asked.deadline_us =
              deadline(asked.deadline_us, fresh.deadline_us, "of chain '" + asked.name + "'");
      kept.push_back(std::move(asked));
    }
    // A chain to what was there before, and that is not asked for, was left out by hand; one to a new XNode was not.
    for (const ChainSpec& fresh : app_.chains) {
      const bool asked = std::any_of(kept.begin(), kept.end(), [&](const ChainSpec& k) {
        return k.from == fresh.from && k.to == fresh.to;
      });
      if (asked) continue;
      const bool new_end = old_.find(app_.xnodes[static_cast<std::size_t>(fresh.to)].name) < 0;
      lines_.push_back((new_end ? "new: chain '" : "not asked for, and so not in it: chain '") +
                       fresh.name + "'");
      if (new_end) kept.push_back(fresh);
    }
    const auto limits = std::count_if(kept.begin(), kept.end(), [](const ChainSpec& c) {
      return c.deadline_us.has_value() || c.weight != 1;
    });
    if (limits > 0)
      lines_.push_back("kept: deadlines or weights of " + std::to_string(limits) + " chains");
    if (!kept.empty()) app_.chains = std::move(kept);
  }

  /// What no program says.
  void messages() {
    for (XNodeSpec& x : app_.xnodes)
      if (const int asked = old_.find(x.name); asked >= 0)
        x.message_bytes = old_.xnodes[static_cast<std::size_t>(asked)].message_bytes;
  }

  void transfers() {
    for (TransferSpec asked : old_.transfers) {
      const auto [u, v] = old_.edges[static_cast<std::size_t>(asked.edge)];
      const std::string &from = old_.xnodes[static_cast<std::size_t>(u)].name,
                        &to = old_.xnodes[static_cast<std::size_t>(v)].name;
      const auto edge = std::find(app_.edges.begin(), app_.edges.end(),
                                  std::pair(app_.find(from), app_.find(to)));
      if (edge == app_.edges.end()) {
        lines_.push_back("left: transfer from '" + from + "' to '" + to + "'");
        continue;
      }
      asked.edge = static_cast<int>(edge - app_.edges.begin());
      app_.transfers.push_back(std::move(asked));
    }
  }

 private:
  using Deadline = std::optional<std::int64_t>;
  /// The file's goes before the program's.
  Deadline deadline(const Deadline& in_file, const Deadline& in_program, const std::string& whose) {
    if (!in_file) return in_program;
    if (in_program && *in_program != *in_file)
      lines_.push_back("kept: the deadline " + whose + ": " + std::to_string(*in_file) +
                       " us (the program says " + std::to_string(*in_program) + ")");
    return in_file;
  }

  AppSpec& app_;
  const AppSpec& old_;
  std::vector<std::string>& lines_;
  bool rates_differ_ = false;
};

/// Every text in it but those of the keys that name no XNode.
void names_in(const ordered_json& entry, std::set<std::string>& names) {
  if (entry.is_string()) names.insert(entry.get<std::string>());
  if (entry.is_array())
    for (const ordered_json& one : entry) names_in(one, names);
  if (entry.is_object())
    for (const auto& [key, value] : entry.items())
      if (key == "xnode" || key == "from" || key == "to") names_in(value, names);
}

/// What only the solver reads: lib/model does not know it.
void keep_objectives(const ordered_json& old, const AppSpec& app, ordered_json& document,
                     std::vector<std::string>& lines) {
  for (const char* key : {"pins", "forbids", "groups", "chains"}) {
    if (!old.contains(key) || document.contains(key) || !old[key].is_array()) continue;
    ordered_json kept = ordered_json::array();
    for (const ordered_json& entry : old[key]) {
      std::set<std::string> names;
      names_in(entry, names);
      const bool there = std::all_of(names.begin(), names.end(),
                                     [&](const std::string& name) { return app.find(name) >= 0; });
      if (there)
        kept.push_back(entry);
      else
        lines.push_back(std::string("left: an entry of \"") + key + "\": " + entry.dump());
    }
    if (!kept.empty()) document[key] = std::move(kept);
  }
}

}  // namespace

Result<std::string> with_what_was_asked(AppSpec fresh, std::string_view old_text,
                                        const std::string& origin,
                                        std::vector<std::string>& lines) {
  XAUTO_ASSIGN(const nlohmann::json parsed, json_document::parse(old_text, origin));
  XAUTO_ASSIGN(const AppSpec old, parse_app(old_text, origin));
  if (old.name != fresh.name) {
    lines.push_back("left: all of app '" + old.name + "', of which the file was");
    return to_json(fresh);
  }
  if (parsed.contains("seen") || parsed.contains("todo"))
    lines.emplace_back("left: \"seen\" and \"todo\", of an import: the profile goes before them");
  Keeper keeper(fresh, old, lines);
  Status valid = keeper.rates();
  if (valid) {
    keeper.sources();
    keeper.modules();
    keeper.chains();
    keeper.messages();
    keeper.transfers();
    valid = validate(fresh);
  }
  if (!valid) {
    Error error = valid.error();
    error.where = origin;
    error.what = "what it asks for and what was measured are no app together: " + error.what;
    error.hint = "mend it, or name another file for the new one";
    return tl::unexpected<Error>(std::move(error));
  }
  const std::string text = to_json(fresh);
  ordered_json document = ordered_json::parse(text);
  keep_objectives(ordered_json(parsed), fresh, document, lines);
  return json_document::to_text(document);
}

}  // namespace xauto
