// SPDX-License-Identifier: Apache-2.0
#include "story/reactions.h"

#include <algorithm>
#include <map>
#include <utility>

#include "base/index.h"
#include "model/components.h"
#include "model/onward.h"

namespace xauto::story {
namespace {

constexpr std::int64_t kNothing = -1;         ///< nothing of this source is in it
constexpr std::int64_t kMostSkipped = 1'000;  ///< as the runtime counts: of one result, the newest

class Follower {
 public:
  Follower(const AppSpec& app, const Story& story, Components parts)
      : app_(app), story_(story), parts_(std::move(parts)), home_(story.num_modules, -1) {
    for (const JobStory& job : story.jobs) home_[at(job.module)] = parts_.of[at(job.xnode)];
    for (std::size_t r = 0; r < story.releases.size(); ++r)
      released_[{story.releases[r].source, static_cast<std::int64_t>(story.releases[r].sequence)}] =
          static_cast<int>(r);
  }

  std::vector<Reaction> follow() {
    std::vector<Reaction> all;
    std::map<int, std::vector<std::int64_t>> known;  // by source: chains share them
    for (std::size_t c = 0; c < app_.chains.size(); ++c) {
      const ChainSpec& chain = app_.chains[c];
      auto found = known.find(chain.from);
      if (found == known.end()) found = known.emplace(chain.from, known_of(chain.from)).first;
      count(static_cast<int>(c), chain, found->second, all);
    }
    return all;
  }

 private:
  /// [component] as the runtime follows it (Graph::Module::sample_origins).
  [[nodiscard]] std::vector<int> ranks_from(int source) const {
    std::vector<char> hears(parts_.components.size(), 0);
    for (std::size_t c = 0; c < hears.size(); ++c) {
      const std::vector<int>& heard = parts_.components[c].sources;
      hears[c] = std::find(heard.begin(), heard.end(), source) != heard.end() ? 1 : 0;
    }
    for (const Activation& a : story_.activations)
      for (const SampleRead& read : a.samples)
        if (read.source == source && home_[at(a.module)] >= 0) hears[at(home_[at(a.module)])] = 1;
    std::vector<std::pair<int, int>> samples;
    for (const auto& [u, v] : app_.samples)
      samples.emplace_back(parts_.of[at(u)], parts_.of[at(v)]);
    return ranks_of(hears, samples);
  }

  /// [activation] the oldest release of `source` that it is made of; kNothing, or kUnknown.
  [[nodiscard]] std::vector<std::int64_t> known_of(int source) const {
    const std::vector<int> rank = ranks_from(source);
    const auto rank_of = [&](int module) {
      return home_[at(module)] < 0 ? kUnreached : rank[at(home_[at(module)])];
    };
    // Who publishes has ended before anybody reads.
    std::vector<std::size_t> order(story_.activations.size());
    for (std::size_t i = 0; i < order.size(); ++i) order[i] = i;
    std::stable_sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) {
      return story_.activations[a].end_ns < story_.activations[b].end_ns;
    });
    std::vector<std::int64_t> known(story_.activations.size(), kNothing);
    for (const std::size_t a : order) {
      const Activation& activation = story_.activations[a];
      std::int64_t& mine = known[a];
      const auto made_of = [&](std::int64_t number) {
        if (number == kNothing || mine == kUnknown) return;
        mine = number == kUnknown || mine == kNothing ? number : std::min(mine, number);
      };
      for (const Take& take : activation.takes) {
        if (take.source >= 0) {
          if (take.source == source)
            made_of(take.from < 0
                        ? kUnknown
                        : static_cast<std::int64_t>(story_.releases[at(take.from)].sequence));
        } else if (rank_of(take.module) != kUnreached) {
          made_of(take.from < 0 ? kUnknown : known[at(take.from)]);
        }
      }
      for (const SampleRead& read : activation.samples) {
        if (read.number < 0) continue;
        if (read.source >= 0) {
          if (read.source == source) made_of(read.number);
        } else if (rank_of(read.module) != kUnreached &&
                   rank_of(read.module) < rank_of(activation.module)) {
          made_of(read.from < 0 ? kUnknown : known[at(read.from)]);
        }
      }
      if (activation.takes.empty()) mine = kUnknown;  // its beginning is not in the trace
    }
    return known;
  }

  void count(int index, const ChainSpec& chain, const std::vector<std::int64_t>& known,
             std::vector<Reaction>& into) const {
    const std::string& module = app_.xnodes[at(chain.to)].module;
    const bool publishes =
        std::none_of(app_.edges.begin(), app_.edges.end(), [&](const std::pair<int, int>& edge) {
          return edge.first == chain.to && app_.xnodes[at(edge.second)].module == module;
        });
    std::vector<std::pair<std::int64_t, int>> ends;  // (end, job)
    for (std::size_t j = 0; j < story_.jobs.size(); ++j) {
      const JobStory& job = story_.jobs[j];
      if (job.xnode != chain.to || !job.complete || job.failed || job.activation < 0) continue;
      const Activation& activation = story_.activations[at(job.activation)];
      if (publishes && activation.fate != Fate::kDone) continue;
      ends.emplace_back(publishes ? activation.end_ns : job.end_ns(), static_cast<int>(j));
    }
    std::sort(ends.begin(), ends.end());
    std::int64_t last = kNothing;
    // A trace that begins later does not tell what was known before. Of what comes through samples
    // the first is not counted, as in the run (Routes).
    const std::vector<int>& heard = parts_.components[at(parts_.of[at(chain.to)])].sources;
    bool since_begin =
        story_.overwritten == 0 && std::find(heard.begin(), heard.end(), chain.from) != heard.end();
    for (const auto& [end_ns, j] : ends) {
      const std::int64_t newest = known[at(story_.jobs[at(j)].activation)];
      if (newest < 0) {  // what was known meanwhile is not known
        if (newest == kUnknown) since_begin = false, last = kNothing;
        continue;
      }
      if (last == kNothing && !std::exchange(since_begin, true)) {
        last = newest;
        continue;
      }
      if (newest <= last) continue;
      const std::int64_t first =
          last == kNothing ? newest : std::max(last + 1, newest - kMostSkipped + 1);
      for (std::int64_t k = first; k <= newest; ++k)
        if (const auto found = released_.find({chain.from, k}); found != released_.end()) {
          const Release& release = story_.releases[at(found->second)];
          const auto& stated = app_.sources[at(chain.from)].urgent;
          const bool urgent =
              stated && (release.urgent || !stated->marked_by.empty()) &&
              story_.activations[at(story_.jobs[at(j)].activation)].urgent_source == chain.from;
          into.push_back({index, k, release.begin_ns, end_ns, j, urgent});
        }
      last = newest;
    }
  }

  static constexpr std::int64_t kUnknown = -2;  ///< the trace does not tell
  const AppSpec& app_;
  const Story& story_;
  const Components parts_;
  std::vector<int> home_;  ///< [module] its component; -1: no job of it is in the trace
  std::map<std::pair<int, std::int64_t>, int> released_;  ///< (source, number) -> Story::releases
};

}  // namespace

std::vector<Reaction> reactions_of(const AppSpec& app, const Story& story) {
  auto parts = find_components(app);
  if (!parts) return {};
  return Follower(app, story, std::move(*parts)).follow();
}

std::optional<ObservedWindow> window_of(const AppSpec& app, const Policy& keys, const Story& story,
                                        const JobStory& job) {
  if (job.activation < 0) return std::nullopt;
  const Activation& activation = story.activations[at(job.activation)];
  const std::int64_t released_ns = activation.released_ns;
  if (released_ns <= 0) return std::nullopt;
  const Placement& placed = keys.placements[at(job.xnode)];
  const auto of = [&](const std::vector<std::int64_t>& us) {
    return us.empty() ? 0 : us[static_cast<std::size_t>(job.sequence % us.size())] * 1000;
  };
  const std::int64_t sooner_ns =
      activation.urgent_source < 0 ? 0
                                   : app.sources[at(activation.urgent_source)].urgent->by_us * 1000;
  return ObservedWindow{released_ns,
                        released_ns + std::max<std::int64_t>(of(placed.hold_us) - sooner_ns, 0),
                        released_ns + of(placed.key_us) - sooner_ns};
}

}  // namespace xauto::story
