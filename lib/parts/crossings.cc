// SPDX-License-Identifier: Apache-2.0
#include "parts/crossings.h"

#include <algorithm>
#include <cstring>
#include <new>
#include <set>
#include <stdexcept>
#include <utility>

#include <fmt/format.h>

#include "base/clock.h"
#include "base/fnv.h"
#include "base/index.h"
#include "base/log.h"
#include "base/rt.h"
#include "base/thread.h"
#include "model/claims.h"
#include "model/components.h"
#include "session/notes.h"

#include "parts/crossing_message.h"

namespace xauto::parts {
namespace {

using runtime::Context;
using runtime::Graph;
using runtime::Grid;

constexpr std::int64_t kMostNs = 60'000'000'000;  ///< until the last message is here, or lost
constexpr std::int64_t kDepth = 16;               ///< messages that wait in DDS
constexpr std::int64_t kFarNs = 1'000'000'000;    ///< no clock is so far ahead

/// One that goes out: encoded on the bridge's thread.
struct Outgoing {
  CrossingHead head;
  std::shared_ptr<const void> message;
  const detail::TopicSpec* spec;
};

std::vector<std::byte> encode_outgoing(const void* message) {
  const auto& out = *static_cast<const Outgoing*>(message);
  if (out.message == nullptr) return encode(out.head, {});
  if (out.spec->plain_bytes > 0)
    return encode(out.head,
                  {static_cast<const std::byte*>(out.message.get()), out.spec->plain_bytes});
  return encode(out.head, out.spec->encode(out.message.get()));
}

/// Throws where it is none: the bridge then counts it as refused.
std::shared_ptr<const void> decode_incoming(std::span<const std::byte> bytes) {
  auto message = decode(bytes);
  if (!message) throw std::runtime_error("no crossing");
  return std::make_shared<const CrossingMessage>(std::move(*message));
}

std::size_t largest(const detail::TopicSpec& spec) {
  return kHeadBytes + (spec.plain_bytes > 0 ? spec.plain_bytes : spec.max_bytes);
}

/// Null: it is no message of this topic.
std::shared_ptr<const void> made_of(const detail::TopicSpec& spec,
                                    const std::vector<std::byte>& payload) try {
  if (spec.plain_bytes == 0) return spec.decode(payload);
  if (payload.size() != spec.plain_bytes) return nullptr;
  constexpr std::align_val_t kAlign{64};  // detail::make_message has no more
  std::shared_ptr<void> room(::operator new(payload.size(), kAlign),
                             [](void* at) { ::operator delete(at, kAlign); });
  std::memcpy(room.get(), payload.data(), payload.size());
  return room;
} catch (...) {  // the program's Codec, or no memory
  return nullptr;
}

detail::TopicSpec on_dds(const detail::TopicSpec& spec, std::uint64_t run) {
  Fnv name;  // names of topics may have what DDS does not allow
  name.add(spec.name);
  detail::TopicSpec dds;
  dds.name = fmt::format("xauto_part/r{:016x}/t{}", run, name.hex());
  dds.type_name = "xauto crossing";
  dds.encode = &encode_outgoing;
  dds.decode = &decode_incoming;
  dds.max_bytes = largest(spec);
  return dds;
}

const TopicQos kQos{
    .reliability = Reliability::kReliable, .durability = Durability::kVolatile, .depth = kDepth};

}  // namespace

std::uint64_t PartStart::first(const Grid::Source& releases, std::int64_t shift_ns) const {
  std::uint64_t before = 0, after = 1;
  const auto ours = [&](std::uint64_t k) { return releases.due_ns(k) - shift_ns >= from_ns; };
  if (ours(0)) return 0;
  while (!ours(after)) before = std::exchange(after, 2 * after);
  while (after - before > 1) {
    const std::uint64_t middle = before + (after - before) / 2;
    (ours(middle) ? after : before) = middle;
  }
  return after;
}

Result<std::vector<Grid::Source>> releases_of_modules(const Graph& graph, const AppSpec& app) {
  XAUTO_ASSIGN(const Components components, find_components(app));
  std::vector<Grid::Source> releases;
  for (const Graph::Module& module : graph.modules) {
    const int xnode = app.find(graph.nodes[at(module.nodes.front())].name);
    const Component& component = components.components[at(components.of[at(xnode)])];
    releases.push_back({.period = component.period, .offset_ns = component.offset_us * 1000});
  }
  return releases;
}

struct Crossings::Out {
  std::size_t topic = 0;
  std::size_t readers = 0;  ///< hosts
  Grid::Source releases;    ///< of its publisher's component
  std::shared_ptr<transport::Publisher> publisher;
  std::uint64_t next = 0;  ///< release; of who publishes, one at a time
};

struct Crossings::In {
  std::size_t topic = 0;
  runtime::CrossingLine* line = nullptr;
  std::string xnode, from, to;  ///< hosts
  CrossingReader::Rule rule;
  std::shared_ptr<transport::Subscriber> subscriber;
  std::optional<CrossingReader> reader = {};  ///< of the thread
  std::uint64_t told = 0;                     ///< losses
  std::uint64_t other_runs = 0, malformed = 0;
  log::Refusals refusals{"parts"};
  /// Onto the board. On the thread.
  void count() const;
};

void Crossings::In::count() const {
  const CrossingReader::Count& count = reader->count();
  line->messages.store(count.expected - count.lost - count.none);
  line->longest_ns.store(count.longest_ns);
  line->latest_ns.store(count.latest_ns);
  line->late.store(count.late);
  line->lost.store(count.lost);
}

Result<std::unique_ptr<Crossings>> Crossings::open(const Context& context,
                                                   std::function<void()> enter) {
  const runtime::HostPart& part = context.session.host;
  if (!part.there()) return nullptr;
  auto made = std::unique_ptr<Crossings>(new Crossings(context));
  XAUTO_ASSIGN(const auto releases, releases_of_modules(context.graph, context.session.app));
  std::vector<std::size_t> out, in;
  transport::BridgeOptions options{.enter = std::move(enter)};
  for (std::size_t t = 0; t < context.graph.topics.size(); ++t) {
    const Graph::Topic& topic = context.graph.topics[t];
    // Topics may be told to programs outside, too, in the same domain, whose limit is that of who comes first.
    options.largest_bytes = std::max(options.largest_bytes, largest(topic.spec));
    if (context.plan.comes_in(topic)) in.push_back(t);
    if (topic.module >= 0 && context.hosts(at(topic.module)) &&
        std::ranges::any_of(topic.subscribers, [&](const Graph::Subscriber& s) {
          return !context.hosts(at(s.module));
        }))
      out.push_back(t);
  }
  if (out.empty() && in.empty()) return made;
  XAUTO_ASSIGN(options.domain, transport::ros_domain());
  XAUTO_ASSIGN(made->bridge_, transport::open_bridge("cyclonedds", options));
  for (const std::size_t t : out) {
    XAUTO_TRY(made->open_out(t));
    made->outs_.back()->releases = releases[at(context.graph.topics[t].module)];
  }
  for (const std::size_t t : in)
    XAUTO_TRY(made->open_in(t, releases[at(context.graph.topics[t].module)]));
  return made;
}

Status Crossings::open_out(std::size_t topic) {
  const Graph::Topic& spec = context_.graph.topics[topic];
  if (spec.spec.buffered.make != nullptr ||
      (spec.spec.plain_bytes == 0 && (spec.spec.encode == nullptr || spec.spec.decode == nullptr)))
    return fail(ErrorCode::kInvalid,
                "messages of type " + spec.spec.type_name + " cannot leave their host",
                "topic '" + spec.spec.name + "'",
                "specialise xauto::Codec for it, or keep its modules on one host");
  auto out = std::make_unique<Out>();
  out->topic = topic;
  std::set<int> hosts;
  for (const Graph::Subscriber& s : spec.subscribers)
    if (!context_.hosts(at(s.module))) hosts.insert(context_.plan.host_of[at(s.module)]);
  out->readers = hosts.size();
  XAUTO_ASSIGN(out->publisher,
               bridge_->publish(on_dds(spec.spec, context_.session.host.run), kQos));
  outs_.push_back(std::move(out));
  return {};
}

Status Crossings::open_in(std::size_t topic, const Grid::Source& releases) {
  const runtime::Session& session = context_.session;
  const Graph::Topic& spec = context_.graph.topics[topic];
  const Graph::Module& module = context_.graph.modules[at(spec.module)];
  auto in = std::make_unique<In>();
  in->topic = topic;
  in->xnode = context_.graph.nodes[at(module.nodes.back())].name;
  const int from = session.app.find(in->xnode);
  const Placement& placed = session.keys->placements[at(from)];
  const Xpu& xpu = session.platform.xpus[at(placed.xpu)];
  in->from = session.platform.hosts[at(xpu.host)].name;
  in->to = session.host.name;
  const int here = session.platform.find_host(session.host.name);
  const auto crossing = std::ranges::find_if(
      session.keys->crossings, [&](const Crossing& c) { return c.from == from && c.host == here; });
  if (crossing == session.keys->crossings.end())
    return fail(ErrorCode::kInvalid, "says of no time in which it is on host '" + in->to + "'",
                "the policy: XNode '" + in->xnode + "'", "solve again");
  in->rule = {.releases = releases,
              .key_us = placed.key_us,
              .x_us = crossing->x_us,
              .urgent_by_us = context_.grid.urgent_by_us[at(spec.module)]};
  // Whether the sender's XPUs are emulated nobody here knows: as ours are.
  if (session.emulates()) {
    in->rule.more_pct = kEmulatorPct;
    in->rule.more_us = kEmulatorUs;
  }
  XAUTO_ASSIGN(in->subscriber, bridge_->subscribe(on_dds(spec.spec, session.host.run), kQos,
                                                  arrived_, static_cast<int>(kDepth)));
  in->line = &context_.board.crossing(ins_.size());
  runtime::name_line(in->line->xnode, in->xnode);
  runtime::name_line(in->line->from, in->from);
  runtime::name_line(in->line->to, in->to);
  in->line->x_us = in->rule.x_us;
  ins_.push_back(std::move(in));
  return {};
}

Crossings::Crossings(const Context& context) : context_(context) {}

Crossings::~Crossings() {
  stop();
}

std::function<void(const detail::Envelope&)> Crossings::sender(std::size_t topic) {
  for (const auto& out : outs_)
    if (out->topic == topic)
      return [this, to = out.get()](const detail::Envelope& envelope) { send(*to, envelope); };
  return nullptr;
}

/// On the thread that publishes: in the order of releases.
void Crossings::send(Out& out, const detail::Envelope& envelope) const {
  const std::int64_t start_ns = start_ns_.load();
  if (start_ns == 0) return;
  auto going = std::make_shared<Outgoing>();
  going->spec = &context_.graph.topics[out.topic].spec;
  going->message = envelope.message;
  CrossingHead& head = going->head;
  head.run = context_.session.host.run;
  head.number = envelope.sequence;
  head.payload = envelope.message != nullptr;
  head.first = head.payload ? head.number : std::min(out.next, head.number);
  if (head.number - head.first >= kMostAtOnce) head.first = head.number;
  out.next = std::max(out.next, head.number + 1);
  head.nominal_ns = out.releases.due_ns(head.number);
  head.urgent = envelope.urgent;
  if (!head.payload && envelope.origin_ns < 0) head.reason = envelope.origin_ns;
  head.origins.fill(kNoOrigin);
  for (std::size_t s = 0; envelope.origins != nullptr && s < head.origins.size(); ++s)
    if ((*envelope.origins)[s] != 0) head.origins[s] = (*envelope.origins)[s] - start_ns;
  out.publisher->publish({going, std::max<std::int64_t>(0, envelope.origin_ns), head.number});
}

bool Crossings::met() const {
  return std::ranges::all_of(
             outs_, [](const auto& out) { return out->publisher->readers() >= out->readers; }) &&
         std::ranges::all_of(ins_, [](const auto& in) { return in->subscriber->publishers() > 0; });
}

Status Crossings::start(const PartStart& start, Deliver deliver, std::function<void()> enter) {
  deliver_ = std::move(deliver);
  for (const auto& in : ins_) in->reader.emplace(in->rule, start.first(in->rule.releases));
  for (const auto& out : outs_) out->next = start.first(out->releases);
  start_ns_.store(start.start_ns);
  if (ins_.empty()) return {};
  XAUTO_ASSIGN(thread_, start_thread([this, enter = std::move(enter)] {
                 enter();
                 run();
               }));
  return {};
}

void Crossings::run() {
  bool ended = false;
  while (!stop_.load()) {
    bool any = false;
    for (const auto& in : ins_)
      for (std::int64_t i = 0; i < kDepth && take(*in); ++i) any = true;
    const std::int64_t now = now_ns() - start_ns_.load();
    if (const std::int64_t end = end_ns_.load(); end != INT64_MAX && !ended) {
      for (const auto& in : ins_) in->reader->end(end);
      ended = true;
    }
    std::int64_t next = INT64_MAX;
    for (const auto& in : ins_) {
      in->reader->pass(now,
                       [&](const detail::Envelope& envelope) { deliver_(in->topic, envelope); });
      tell_losses(*in);
      next = std::min(next, in->reader->next_ns());
    }
    if (ended && std::ranges::all_of(ins_, [](const auto& in) { return in->reader->over(); }))
      over_.store(true);
    if (any) continue;
    arrived_.wait(
        [&] {
          return !stop_.load() && (ended || end_ns_.load() == INT64_MAX) &&
                 std::ranges::all_of(ins_, [](const auto& in) { return in->subscriber->empty(); });
        },
        std::clamp<std::int64_t>(next - now, 1, kLookNs));
  }
}

/// False: nothing waits.
bool Crossings::take(In& in) {
  const auto arrived = in.subscriber->take();
  if (!arrived) return false;
  hear(in, *arrived, now_ns() - start_ns_.load());
  return true;
}

void Crossings::hear(In& in, const detail::Envelope& arrived, std::int64_t now_ns) {
  const auto& message = *static_cast<const CrossingMessage*>(arrived.message.get());
  const CrossingHead& head = message.head;
  if (head.run != context_.session.host.run) {
    ++in.other_runs;
    return;
  }
  const detail::TopicSpec& spec = context_.graph.topics[in.topic].spec;
  const std::int64_t start_ns = start_ns_.load();
  detail::Envelope envelope{nullptr, head.reason, head.number};
  if (head.payload) {
    envelope.message = made_of(spec, message.payload);
    if (envelope.message == nullptr) {
      ++in.malformed;
      return;
    }
    envelope.origin_ns = start_ns + head.nominal_ns;
    envelope.urgent = head.urgent;
    auto origins = std::make_shared<detail::Origins>();
    origins->fill(0);
    for (std::size_t s = 0; s < origins->size(); ++s) {
      if (head.origins[s] == kNoOrigin) continue;
      if (head.origins[s] < 0 || head.origins[s] > now_ns + kFarNs) {
        ++in.malformed;
        return;
      }
      (*origins)[s] = start_ns + head.origins[s];
    }
    envelope.origins = std::move(origins);
  }
  (void)in.reader->arrive(head.first, envelope, head.nominal_ns, now_ns);
}

/// At once: within a period of its sender.
void Crossings::tell_losses(In& in) {
  const CrossingReader::Count& count = in.reader->count();
  in.count();
  if (count.lost == in.told) return;
  in.told = count.lost;
  in.refusals.tell(
      fmt::format("release {} of XNode '{}' was not here, from '{}' to '{}', by its key + X "
                  "= {:.3f} ms: it is lost",
                  in.reader->last_lost() - 1, in.xnode, in.from, in.to,
                  static_cast<double>(in.rule.x_us) / 1000),
      now_ns());
}

bool Crossings::finish(std::int64_t end_ns) {
  if (!thread_.joinable()) return true;
  end_ns_.store(end_ns);
  arrived_.ring();
  const std::int64_t limit = now_ns() + kMostNs;
  while (!over_.load() && now_ns() < limit) sleep_until_ns(now_ns() + 1'000'000);
  return over_.load();
}

void Crossings::stop() {
  if (bridge_) bridge_->stop();
  stop_.store(true);
  arrived_.ring();
  if (thread_.joinable()) thread_.join();
}

void Crossings::report(runtime::RunReport& into) const {
  for (const auto& in : ins_) {
    if (!in->reader) continue;
    const CrossingReader::Count& count = in->reader->count();
    into.crossings.push_back({.xnode = in->xnode,
                              .from = in->from,
                              .to = in->to,
                              .x_us = in->rule.x_us,
                              .messages = count.expected - count.lost - count.none,
                              .longest_us = count.longest_ns / 1000,
                              .lost = count.lost,
                              .late = count.late,
                              .latest_us = count.latest_ns / 1000,
                              .twice = count.twice,
                              .refused = count.refused + in->malformed + in->subscriber->lost(),
                              .other_runs = in->other_runs});
  }
  if (bridge_)
    for (const std::string& note : bridge_->notes()) runtime::add_note(into.note, note);
}

}  // namespace xauto::parts
