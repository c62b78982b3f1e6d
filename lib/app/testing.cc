// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <stdexcept>

#include <xauto/testing.h>

#include "emu/client.h"
#include "graph/app_spec.h"
#include "graph/graph.h"
#include "graph/input_access.h"

namespace xauto::testing {
namespace {

struct Step {
  std::string xnode;
  std::int64_t start_ns = 0, end_ns = 0;
};

/// What contexts find on this thread, as long as this lives.
class SiteScope {
 public:
  explicit SiteScope(std::shared_ptr<const emu::Site> site) : before_(emu::this_threads_site()) {
    emu::set_this_threads_site(std::move(site));
  }
  ~SiteScope() { emu::set_this_threads_site(before_); }
  SiteScope(const SiteScope&) = delete;
  SiteScope& operator=(const SiteScope&) = delete;

 private:
  std::shared_ptr<const emu::Site> before_;
};

/// `run`, a Status(), with what it throws as an error.
template <class Run>
Status contained(const std::string& where, Run run) {
  try {
    if (Status status = run(); !status) {
      Error error = std::move(status).error();
      error.where = error.where.empty() ? where : where + ": " + error.where;
      return tl::unexpected<Error>(std::move(error));
    }
    return {};
  } catch (const std::exception& e) {
    return fail(ErrorCode::kUnavailable, std::string("threw: ") + e.what(), where);
  } catch (...) {
    return fail(ErrorCode::kUnavailable, "threw something that is no std::exception", where);
  }
}

}  // namespace

struct Outcome::Data {
  std::vector<detail::TopicSpec> topics;
  std::vector<std::shared_ptr<const void>> messages;  ///< by topic
  std::vector<Step> steps;

  [[nodiscard]] Step step(const std::string& xnode) const {
    const auto at =
        std::find_if(steps.begin(), steps.end(), [&](const Step& s) { return s.xnode == xnode; });
    return at == steps.end() ? Step{} : *at;
  }
};

Outcome::Outcome(std::shared_ptr<const Data> data) : data_(std::move(data)) {}
Outcome::Outcome(const Outcome&) = default;
Outcome& Outcome::operator=(const Outcome&) = default;
Outcome::~Outcome() = default;

std::vector<std::string> Outcome::xnodes() const {
  std::vector<std::string> names;
  for (const Step& step : data_->steps) names.push_back(step.xnode);
  return names;
}
std::chrono::microseconds Outcome::start(const std::string& xnode) const {
  return std::chrono::microseconds(data_->step(xnode).start_ns / 1000);
}
std::chrono::microseconds Outcome::end(const std::string& xnode) const {
  return std::chrono::microseconds(data_->step(xnode).end_ns / 1000);
}

const std::shared_ptr<const void>& Outcome::find(const std::string& topic,
                                                 const std::type_info& type) const {
  for (std::size_t i = 0; i < data_->topics.size(); ++i) {
    if (data_->topics[i].name != topic) continue;
    if (data_->topics[i].type != type)
      throw std::logic_error("topic '" + topic + "' carries " + data_->topics[i].type_name);
    return data_->messages[i];
  }
  throw std::logic_error("topic '" + topic + "' is not an output of this XModule");
}

struct Fire::Data {
  struct Node {
    const detail::XNodeSpecErased* spec;
    const detail::ImplSpec* impl = nullptr;  ///< null: not chosen yet
    detail::Made made;
    bool ready = false;
  };
  detail::XModuleSpec module;  ///< a copy: the test may go on building
  std::vector<Node> nodes;
  std::vector<std::string> misuse;
  std::shared_ptr<void> state;
  std::vector<detail::TopicSpec> topics;              ///< inputs, then what is sampled
  std::vector<std::shared_ptr<const void>> messages;  ///< by topic
  std::vector<std::int64_t> put_ns;                   ///< by topic: when that was put
  std::vector<detail::ParameterHandle> declared;
  std::vector<detail::ParameterNow> parameters;
  std::shared_ptr<std::int64_t> clock_ns = std::make_shared<std::int64_t>(0);
  std::int64_t within_ns = 0;  ///< Fire::due; 0: nothing says
  std::uint64_t sequence = 0;
  std::shared_ptr<emu::Site> site = std::make_shared<emu::Site>();

  /// As in a run, where only what is sampled can be.
  [[nodiscard]] bool too_old(std::size_t topic) const {
    if (topic < module.inputs.size()) return false;
    const std::int64_t limit_ns = module.samples[topic - module.inputs.size()].max_age_ns;
    return limit_ns > 0 && *clock_ns - put_ns[topic] > limit_ns;
  }
  void set(const detail::ParameterSpec& parameter, const ParameterValue& value);
  [[nodiscard]] Status check();
  [[nodiscard]] Status prepare();
  [[nodiscard]] Status exec(const Input& input, Outcome::Data& outcome);
};

// By value: their headers are the ABI.
Fire::Fire(
    std::shared_ptr<detail::XModuleSpec> module)  // NOLINT(performance-unnecessary-value-param)
    : data_(std::make_unique<Data>()) {
  data_->module = *module;
  for (const auto& node : data_->module.nodes) data_->nodes.push_back({node.get(), nullptr, {}});
  data_->topics = data_->module.inputs;
  for (const auto& sample : data_->module.samples) data_->topics.push_back(sample.topic);
  data_->declared = detail::parameters_of(data_->module);
  data_->parameters = detail::initial_of(data_->declared);
  data_->messages.resize(data_->topics.size());
  data_->put_ns.resize(data_->topics.size());
  data_->site->virtual_ns = data_->clock_ns;
}

Fire::~Fire() {
  const SiteScope scope(data_->site);
  for (auto node = data_->nodes.rbegin(); node != data_->nodes.rend(); ++node)
    node->made.object.reset();
}

Fire& Fire::on(const std::string& xnode, const XPU& type) {
  const auto at = std::find_if(data_->nodes.begin(), data_->nodes.end(),
                               [&](const auto& n) { return n.spec->name == xnode; });
  if (at == data_->nodes.end())
    data_->misuse.push_back("it has no XNode '" + xnode + "'");
  else if (at->ready)
    data_->misuse.push_back("XNode '" + xnode + "' has run already");
  else if (at->impl = runtime::find_impl(*at->spec, type.type()); at->impl == nullptr)
    data_->misuse.push_back("XNode '" + xnode + "' has no implementation for '" + type.type() +
                            "'");
  return *this;
}

// NOLINTNEXTLINE(performance-unnecessary-value-param)
void Fire::put(detail::TopicHandle topic, std::shared_ptr<const void> message) {
  for (std::size_t i = 0; i < data_->topics.size(); ++i)
    if (detail::TopicSpec& input = data_->topics[i]; input.name == topic->name) {
      if (detail::is_name_alone(input)) input = *topic;  // who puts it knows what it carries
      if (input.type == topic->type) {
        data_->messages[i] = std::move(message);
        data_->put_ns[i] = *data_->clock_ns;
      } else
        data_->misuse.push_back("topic '" + input.name + "' carries " + input.type_name + ", not " +
                                topic->type_name);
      return;
    }
  data_->misuse.push_back("topic '" + topic->name +
                          "' is neither an input of it nor sampled by it");
}

void Fire::Data::set(const detail::ParameterSpec& parameter, const ParameterValue& value) {
  const auto now = std::find_if(parameters.begin(), parameters.end(),
                                [&](const auto& p) { return p.spec == &parameter; });
  if (now == parameters.end())
    misuse.push_back("parameter '" + parameter.name + "' is not declared by it");
  else if (const auto taken = parameter.take(value); taken)
    now->set(*taken);
  else
    misuse.push_back("parameter '" + parameter.name + "' " + taken.error().what);
}

// NOLINTBEGIN(performance-unnecessary-value-param)
Fire& Fire::due(std::chrono::nanoseconds within) {
  if (within.count() <= 0) data_->misuse.emplace_back("due() takes a time above 0");
  data_->within_ns = within.count();
  return *this;
}

void Fire::set_integer(detail::ParameterHandle parameter, std::int64_t value) {
  if (parameter->type() == ParameterType::kBoolean)
    data_->set(*parameter, value != 0);
  else
    data_->set(*parameter, value);
}
void Fire::set_real(detail::ParameterHandle parameter, double value) {
  data_->set(*parameter, value);
}
void Fire::set_text(detail::ParameterHandle parameter, std::string value) {
  data_->set(*parameter, std::move(value));
}
// NOLINTEND(performance-unnecessary-value-param)

/// What the test did wrong, and the App would refuse.
Status Fire::Data::check() {
  std::vector<std::string> problems = module.misuse;
  for (const Node& node : nodes) {
    problems.insert(problems.end(), node.spec->misuse.begin(), node.spec->misuse.end());
    if (node.spec->impls.empty())
      problems.push_back("XNode '" + node.spec->name + "' has no implementation");
  }
  problems.insert(problems.end(), misuse.begin(), misuse.end());
  for (const detail::ParameterHandle& parameter : declared)
    if (const std::string wrong = parameter->misuse(); !wrong.empty()) problems.push_back(wrong);
  if (nodes.empty()) problems.emplace_back("it has no XNode");
  for (std::size_t i = 0; i < module.inputs.size(); ++i)
    if (messages[i] == nullptr)
      problems.push_back("topic '" + module.inputs[i].name + "' has no message: put() one");
  misuse.clear();
  if (problems.empty()) return {};
  std::string text = problems.front();
  for (std::size_t i = 1; i < problems.size(); ++i) text += "\n  " + problems[i];
  return fail(ErrorCode::kInvalid, text, "XModule '" + module.name + "'");
}

/// Of the state and the XNodes, what was not made yet.
Status Fire::Data::prepare() {
  if (state == nullptr)
    XAUTO_TRY(contained("the state of XModule '" + module.name + "'", [&]() -> Status {
      state = module.make_state();
      if (state == nullptr) return fail(ErrorCode::kInvalid, "its factory returned null");
      return {};
    }));
  for (Node& node : nodes) {
    if (node.ready) continue;
    if (node.impl == nullptr) node.impl = &node.spec->impls.front();
    const XpuId id{node.impl->xpu.type() + "0", node.impl->xpu, 0};
    XAUTO_TRY(contained("init of XNode '" + node.spec->name + "' on " + id.name, [&]() -> Status {
      node.made.handle = node.impl->init(id, state.get(), node.made.object);
      return {};
    }));
    node.ready = true;
  }
  return {};
}

Status Fire::Data::exec(const Input& input, Outcome::Data& outcome) {
  for (Node& node : nodes) {
    const std::int64_t start_ns = *clock_ns;
    XAUTO_TRY(
        contained("exec of XNode '" + node.spec->name + "' on " + node.impl->xpu.type() + "0",
                  [&] { return node.impl->exec(node.made.object.get(), state.get(), input); }));
    outcome.steps.push_back({node.spec->name, start_ns, *clock_ns});
  }
  for (const detail::OutputSpec& output : module.outputs)
    XAUTO_TRY(contained("output topic '" + output.topic.name + "'", [&]() -> Status {
      outcome.topics.push_back(output.topic);
      outcome.messages.push_back(output.take(state.get(), nullptr));
      return {};
    }));
  return {};
}

Result<Outcome> Fire::run() {
  Data& d = *data_;
  XAUTO_TRY(d.check());
  const SiteScope scope(d.site);
  XAUTO_TRY(d.prepare());
  Input input = InputAccess::make();
  InputAccess::bind(input, &d.topics, d.module.inputs.size());
  InputAccess::parameters(input) = d.parameters;
  InputAccess::begin(input, *d.clock_ns);
  const std::uint64_t sequence = d.sequence++;
  InputAccess::stamp(input, *d.clock_ns, sequence);
  InputAccess::clock(input, d.clock_ns.get());
  if (const std::int64_t due_ns = *d.clock_ns + d.within_ns; d.within_ns > 0)
    InputAccess::due(input, due_ns, due_ns);
  for (std::size_t i = 0; i < d.messages.size(); ++i)
    if (!d.too_old(i)) InputAccess::messages(input)[i] = {d.messages[i], d.put_ns[i], sequence};
  auto outcome = std::make_shared<Outcome::Data>();
  XAUTO_TRY(d.exec(input, *outcome));
  return Outcome(std::move(outcome));
}

}  // namespace xauto::testing
