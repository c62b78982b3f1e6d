// SPDX-License-Identifier: Apache-2.0
#include "story/trace_reader.h"

#include <algorithm>
#include <limits>
#include <unordered_map>

#include "story/perfetto.pb.h"

namespace xauto::story {
namespace {

namespace proto = ::xauto::perfetto;

enum class Place : std::uint8_t {
  kOther,
  kRoot,
  kRunRows,  // groups ...
  kChains,
  kCounters,
  kReleases,  // ... and what is drawn
  kRun,
  kChain,
  kSamples,
  kTables,
  kDone,
  kLost,
  kOverwritten,
  kDropped
};

class TraceFile {
 public:
  explicit TraceFile(const std::string& where) : where_(where) {}

  Status take(const proto::TracePacket& packet) {
    ++packet_;
    if (packet.has_track_descriptor()) return take_track(packet.track_descriptor());
    if (packet.has_track_event()) return take_event(packet);
    return {};  // other data sources' packets are not ours to judge
  }

  Result<ReadTrace> finish() {
    if (!ours_)
      return bad(
          "was not written by `xauto run --trace-out` or `xauto compare`: it has no track "
          "'releases' and 'run'");
    for (const auto& [track, stack] : open_)
      if (!stack.empty()) return bad("ends inside a slice of track '" + tracks_[track].name + "'");
    for (TraceReactions& chain : out_.reactions)
      std::stable_sort(chain.releases.begin(), chain.releases.end(),
                       [](const auto& a, const auto& b) { return a.number < b.number; });
    return std::move(out_);
  }

 private:
  struct Track {
    std::string name;
    std::uint64_t parent = 0;
    Place place = Place::kOther;
    int row = -1;
  };

  tl::unexpected<Error> bad(const std::string& what) const {
    return fail(ErrorCode::kInvalid, what, where_ + ", packet " + std::to_string(packet_));
  }

  /// Sums of such do not overflow.
  static bool is_time(std::int64_t us) {
    constexpr std::int64_t kMostUs = 1'000'000'000'000;
    return us > -kMostUs && us < kMostUs;
  }

  Status take_track(const proto::TrackDescriptor& d) {
    Track track{d.name(), d.parent_uuid(), Place::kOther, -1};
    const auto parent = tracks_.find(track.parent);
    const Place above = parent == tracks_.end() ? Place::kOther : parent->second.place;
    if (parent == tracks_.end() && !rooted_) {  // what was put behind has roots of its own
      rooted_ = true;
      track.place = Place::kRoot;
      out_.title = track.name;
      out_.note = d.description();
    } else if (above == Place::kRoot) {
      track.place = place_of(track.name);
      if (track.place == Place::kChains || track.place == Place::kTables)
        out_.verdict = d.description();
    } else if (above == Place::kCounters) {
      if (track.name == "trace events lost") track.place = Place::kLost;
      if (track.name == "older trace events dropped") track.place = Place::kOverwritten;
      if (track.name == "activations dropped") track.place = Place::kDropped;
    } else if (above == Place::kRunRows) {
      ours_ = true;
      track.place = Place::kRun;
      track.row = row_of(track.name);
    } else if (above == Place::kChains) {
      track.place = Place::kChain;
      track.row = chain_of(track.name);
      if (!d.description().empty())
        out_.reactions[static_cast<std::size_t>(track.row)].note = d.description();
    }
    if (d.uuid() == 0 || !tracks_.emplace(d.uuid(), std::move(track)).second)
      return bad("describes track " + std::to_string(d.uuid()) + " twice");
    return {};
  }

  static Place place_of(const std::string& name) {
    for (const auto& [known, place] :
         {std::pair{"releases", Place::kReleases}, std::pair{"done", Place::kDone},
          std::pair{"samples", Place::kSamples}, std::pair{"tables", Place::kTables},
          std::pair{"run", Place::kRunRows}, std::pair{"chains", Place::kChains},
          std::pair{"counters", Place::kCounters}})
      if (name == known) return place;
    return Place::kOther;
  }

  /// Lanes of one chain have one name.
  int chain_of(const std::string& name) {
    auto at = std::find_if(out_.reactions.begin(), out_.reactions.end(),
                           [&](const TraceReactions& c) { return c.name == name; });
    if (at == out_.reactions.end()) at = out_.reactions.insert(at, {name, {}, -1, {}});
    return static_cast<int>(at - out_.reactions.begin());
  }

  int row_of(const std::string& name) {
    const auto at = std::find(out_.rows.begin(), out_.rows.end(), name);
    if (at == out_.rows.end()) out_.rows.push_back(name);
    return static_cast<int>(std::find(out_.rows.begin(), out_.rows.end(), name) -
                            out_.rows.begin());
  }

  Status take_event(const proto::TracePacket& packet) {
    const proto::TrackEvent& event = packet.track_event();
    const auto at = tracks_.find(event.track_uuid());
    if (at == tracks_.end()) return bad("is on a track that was not described");
    const Track& track = at->second;
    if (packet.timestamp() > std::uint64_t{std::numeric_limits<std::int64_t>::max()} / 2)
      return bad("has a time stamp out of range");
    const auto ts = static_cast<std::int64_t>(packet.timestamp());
    // Tracks that are not ours may come from a file that was put behind.
    if (track.place != Place::kOther && ts < out_.end_ns) return bad("goes back in time");
    if (track.place == Place::kRun || track.place == Place::kReleases) {
      if (out_.begin_ns == 0) out_.begin_ns = ts;
      out_.end_ns = ts;
    }
    switch (event.type()) {
      case proto::TrackEvent::TYPE_COUNTER:
        if (track.place == Place::kLost) out_.lost = event.counter_value();
        if (track.place == Place::kOverwritten) out_.overwritten = event.counter_value();
        if (track.place == Place::kDropped) out_.dropped = event.counter_value();
        return {};
      case proto::TrackEvent::TYPE_SLICE_END:
        return end(event.track_uuid(), track, ts);
      case proto::TrackEvent::TYPE_SLICE_BEGIN:
      case proto::TrackEvent::TYPE_INSTANT:
        return begin(event, track, ts);
      default:
        return {};
    }
  }

  Status begin(const proto::TrackEvent& event, const Track& track, std::int64_t ts) {
    const bool slice = event.type() == proto::TrackEvent::TYPE_SLICE_BEGIN;
    int index = -1;
    if (track.place == Place::kReleases && slice) {
      index = static_cast<int>(out_.releases.size());
      TraceRelease release{0, ts, {}};
      for (const auto& arg : event.debug_annotations()) {
        if (arg.name() == "release") release.number = arg.int_value();
        if (arg.name() == "source") release.source = arg.string_value();
      }
      out_.releases.push_back(std::move(release));
      for (const std::uint64_t flow : event.flow_ids()) released_[flow] = index;
    } else if (track.place == Place::kChain) {
      if (slice) take_reaction(event, track, ts);
    } else if (track.place == Place::kChains) {
      take_counts(event);
    } else if (track.place == Place::kSamples) {
      take_sample(event, ts);
    } else if (track.place == Place::kTables) {
      take_table(event, ts);
    } else if (track.place == Place::kRun) {
      auto& list = out_.run;
      index = static_cast<int>(list.size());
      list.push_back(slice_of(event, track.row, ts));
      for (const std::uint64_t flow : event.terminating_flow_ids())
        if (const auto source = flows_.find(flow); source != flows_.end()) {
          list.back().from.push_back(source->second);
        } else if (const auto release = released_.find(flow); release != released_.end()) {
          list.back().releases.push_back(release->second);
          list.back().released_ns =
              std::max(list.back().released_ns,
                       out_.releases[static_cast<std::size_t>(release->second)].begin_ns);
        } else if (const auto sample = sampled_.find(flow); sample != sampled_.end()) {
          list.back().samples.push_back(sample->second);
        }
      for (const std::uint64_t flow : event.flow_ids()) flows_[flow] = index;
    }
    if (slice) open_[event.track_uuid()].push_back(index);
    return {};
  }

  void take_counts(const proto::TrackEvent& event) {
    ChainCounts counts;
    for (const auto& arg : event.debug_annotations()) {
      if (arg.name() == "chain") counts.name = arg.string_value();
      if (arg.name() == "results") counts.results = arg.int_value();
      if (arg.name() == "misses") counts.misses = arg.int_value();
      if (arg.name() == "lost") counts.lost = arg.int_value();
      if (arg.name() == "exceeded") counts.exceeded = arg.int_value() != 0;
      if (!is_time(arg.int_value()) || arg.int_value() < 0) continue;
      if (arg.name() == "p50_us") counts.p50_us = arg.int_value();
      if (arg.name() == "p99_us") counts.p99_us = arg.int_value();
      if (arg.name() == "max_us") counts.max_us = arg.int_value();
      if (arg.name() == "worst_case_us") counts.worst_case_us = arg.int_value();
      if (arg.name() == "lower_bound_us") counts.lower_bound_us = arg.int_value();
      if (arg.name() == "deadline_us") counts.deadline_us = arg.int_value();
    }
    out_.counts.push_back(std::move(counts));
  }

  void take_reaction(const proto::TrackEvent& event, const Track& track, std::int64_t ts) {
    TraceReactions::One one{0, ts, 0, {}, -1, false};
    for (const auto& arg : event.debug_annotations()) {
      if (arg.name() == "release") one.number = arg.int_value();
      if (arg.name() == "reaction_us") one.reaction_us = arg.int_value();
      if (arg.name() == "xnode") one.xnode = arg.string_value();
      if (arg.name() == "activation") one.activation = arg.int_value();
      if (arg.name() == "urgent") one.urgent = arg.int_value() != 0;
      if (arg.name() == "deadline_us" && is_time(arg.int_value()))
        out_.reactions[static_cast<std::size_t>(track.row)].deadline_us = arg.int_value();
    }
    if (one.reaction_us < 0 || !is_time(one.reaction_us)) return;
    out_.reactions[static_cast<std::size_t>(track.row)].releases.push_back(std::move(one));
  }

  /// Arrows lead from what published it to the instant, and from there to who reads.
  void take_sample(const proto::TrackEvent& event, std::int64_t ts) {
    TraceSample sample;
    sample.at_ns = ts;
    for (const auto& arg : event.debug_annotations()) {
      if (arg.name() == "read") sample.read = arg.string_value();
      if (arg.name() == "number") sample.number = arg.int_value();
      if (arg.name() == "age_us" && is_time(arg.int_value())) sample.age_us = arg.int_value();
    }
    for (const std::uint64_t flow : event.terminating_flow_ids())
      if (const auto slice = flows_.find(flow); slice != flows_.end())
        sample.slice = slice->second;
      else if (const auto release = released_.find(flow); release != released_.end())
        sample.release = release->second;
    for (const std::uint64_t flow : event.flow_ids()) sampled_[flow] = sample;
  }

  void take_table(const proto::TrackEvent& event, std::int64_t ts) {
    TraceScenario scenario;
    TraceChange change{ts, -1, {}, {}, {}, {}, {}, -1, -1};
    for (const auto& arg : event.debug_annotations()) {
      const bool time = is_time(arg.int_value()) && arg.int_value() >= 0;
      if (arg.name() == "release") change.release = arg.int_value();
      if (arg.name() == "from") change.from = arg.string_value();
      if (arg.name() == "to") change.to = arg.string_value();
      if (arg.name() == "why") change.why = arg.string_value();
      if (arg.name() == "chain") change.chain = arg.string_value();
      if (arg.name() == "scenario") scenario.name = arg.string_value();
      if (arg.name() == "table") scenario.table = change.table = arg.string_value();
      if (arg.name() == "releases") scenario.releases = arg.int_value();
      if (!time) continue;
      if (arg.name() == "spanned_us") change.spanned_us = arg.int_value();
      if (arg.name() == "worst_case_us") change.worst_case_us = arg.int_value();
    }
    if (event.categories_size() > 0 && event.categories(0) == "scenario")
      out_.scenarios.push_back(std::move(scenario));
    else
      out_.changes.push_back(std::move(change));
  }

  Status end(std::uint64_t uuid, const Track& track, std::int64_t ts) {
    auto& stack = open_[uuid];
    if (stack.empty()) return bad("ends a slice of track '" + track.name + "' that never began");
    const int index = stack.back();
    stack.pop_back();
    if (index >= 0 && track.place == Place::kRun)
      out_.run[static_cast<std::size_t>(index)].end_ns = ts;
    return {};
  }

  static TraceSlice slice_of(const proto::TrackEvent& event, int row, std::int64_t ts) {
    TraceSlice s;
    s.name = event.name();
    if (event.categories_size() > 0) s.category = event.categories(0);
    s.row = row;
    s.begin_ns = s.end_ns = ts;
    for (const auto& arg : event.debug_annotations()) {
      if (arg.name() == "release") s.release = arg.int_value();
      if (arg.name() == "activation") s.activation = arg.int_value();
      if (arg.name() == "waited_us") s.waited_us = arg.int_value();
      if (arg.name() == "part") s.part = arg.int_value();
      if (arg.name() == "module") s.module = arg.string_value();
      if (!is_time(arg.int_value())) continue;
      if (arg.name() == "since_release_us") s.since_release_us = arg.int_value();
      if (arg.name() == "held_us") s.held_us = arg.int_value();
      if (arg.name() == "key_us") s.key_us = arg.int_value();
      if (arg.name() == "without_core_us")
        s.without_core_us = std::max<std::int64_t>(arg.int_value(), 0);
      if (arg.name() == "lateness_us") s.lateness_us = arg.int_value();
    }
    return s;
  }

  const std::string& where_;
  ReadTrace out_;
  std::unordered_map<std::uint64_t, Track> tracks_;
  std::unordered_map<std::uint64_t, std::vector<int>> open_;
  std::unordered_map<std::uint64_t, int> flows_;            ///< arrow -> its source in `run`
  std::unordered_map<std::uint64_t, int> released_;         ///< arrow -> its release
  std::unordered_map<std::uint64_t, TraceSample> sampled_;  ///< arrow -> what it leaves
  std::size_t packet_ = 0;
  bool ours_ = false, rooted_ = false;
};

}  // namespace

Result<ReadTrace> read_trace(const std::string& bytes, const std::string& where) {
  if (bytes.empty())
    return fail(ErrorCode::kInvalid, "is empty", where, "did the run end before it wrote it?");
  if (bytes.size() > kMaxTraceBytes)
    return fail(ErrorCode::kInvalid, "is larger than 1 GiB", where, "trace fewer activations");
  proto::Trace trace;
  if (!trace.ParseFromString(bytes))
    return fail(ErrorCode::kInvalid, "is no Perfetto trace, or was broken off", where,
                "write one with `xauto run --trace-out FILE.pftrace`");
  TraceFile file(where);
  for (const proto::TracePacket& packet : trace.packet()) XAUTO_TRY(file.take(packet));
  return file.finish();
}

}  // namespace xauto::story
