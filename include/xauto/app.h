// SPDX-License-Identifier: Apache-2.0
// App: owns the modules, checks that they fit together, and runs them.
#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <utility>

#include <xauto/rate.h>
#include <xauto/result.h>
#include <xauto/run.h>
#include <xauto/source.h>
#include <xauto/topic.h>
#include <xauto/xmodule.h>

namespace xauto {

/// An application. Threads: build and run it from one thread.
///
///   int main(int argc, char** argv) {
///     xauto::App app("camera");
///     app.add_source(image, 33ms, grab);
///     app.add_module(camera);
///     return app.main(argc, argv);
///   }
class App {
 public:
  /// `name` is what the tools and app.json call the app.
  explicit App(std::string name);
  ~App();
  App(const App&) = delete;
  App& operator=(const App&) = delete;

  /// Adds a module. XNodes that are appended to it later still count, until check() or main().
  template <class State>
  App& add_module(const XModule<State>& module) {
    add_module_spec(module.spec_);
    return *this;
  }

  /// A sensor: publishes `make(sequence)`, a T, on `topic` every `period` (1 us to 1 h), from
  /// sequence 0 on. `make` is called before the release is due, on one thread for all sources; if
  /// it throws a std::exception, the run ends with the message. Sources of equal period release at
  /// the same instants. With a recorded input, the recording's messages of this topic come instead.
  template <class T, class Make>
  App& add_source(const Topic<T>& topic, std::chrono::microseconds period, Make make) {
    add_source_spec(
        detail::topic_spec(topic), period,
        [make = std::move(make)](std::uint64_t sequence, detail::MessageMemory* memory) mutable {
          return detail::make_message<T>(memory, [&]() -> T { return make(sequence); });
        });
    return *this;
  }

  /// The same of a sensor whose rate is no whole number of microseconds: 30_hz, 29.97_hz
  /// (xauto::literals). app.json then says so, exactly.
  template <class T, class Make>
  App& add_source(const Topic<T>& topic, Rate rate, Make make) {
    add_source(topic, std::chrono::microseconds(1), std::move(make));
    set_source_rate(rate);
    return *this;
  }

  /// The same of a sensor some of whose releases are urgent (source.h): those of which
  /// `urgent(const T&, sequence)`, called after `make` on the same thread, returns true. Where nothing
  /// certifies urgent releases (app.json, policy) they are ordinary ones, and the report tells how
  /// many. Not called in lockstep, with a recorded input, and by `xauto profile`.
  template <class T, class Period, class Make, class Urgent>
  App& add_source(const Topic<T>& topic, Period period, Make make, Urgent urgent) {
    add_source(topic, period, std::move(make));
    mark_source_spec(
        [urgent = std::move(urgent)](const void* message, std::uint64_t sequence) mutable -> bool {
          return urgent(*static_cast<const T*>(message), sequence);
        });
    return *this;
  }

  /// A sensor that is pushed into, e.g. from a driver's callback. What Source::publish is given is
  /// released at once, in the process that has the app's other sources. docs/api.md has the rules.
  template <class T>
  [[nodiscard]] Source<T> add_source(const Topic<T>& topic, Pushed how) {
    Source<T> source(add_inlet(detail::topic_spec(topic), how.distance));
    if (how.rate.num > 0) set_source_rate(how.rate);
    return source;
  }

  /// What is asked of all chains: what follows from a release, by input topics and samples, has ended
  /// at most `limit` (1 us to 1e6 s) later. `xauto profile` writes it into app.json; what app.json says
  /// counts, and a person may change it there. A deadline of a single chain goes before it.
  App& deadline(std::chrono::microseconds limit);
  /// The same of the chain from source `from` until `to` is published.
  template <class From, class To>
  App& deadline(const Topic<From>& from, const Topic<To>& to, std::chrono::microseconds limit) {
    add_deadline(detail::topic_spec(from), detail::topic_spec(to), nullptr, limit);
    return *this;
  }
  /// The same of the chain from source `from` until module `end` has ended.
  template <class From, class State>
  App& deadline(const Topic<From>& from, const XModule<State>& end,
                std::chrono::microseconds limit) {
    add_deadline(detail::topic_spec(from), nullptr, end.spec_, limit);
    return *this;
  }

  /// Source `source` releases by a clock of its own, e.g. that of a camera, which is at most `ppm`
  /// (0 to 100 000) faster or slower than its rate says. Sources of one clock keep their distance; those
  /// of two have none. Without it sources have this machine's clock. As a deadline it goes into app.json.
  template <class T>
  App& clock(const Topic<T>& source, const std::string& name, int ppm = 100) {
    set_clock(detail::topic_spec(source), name, ppm);
    return *this;
  }

  /// Calls `callback(const T&, sequence)` for each message on `topic`, on the publishing thread: be
  /// short. Several observers of one topic are called in the order of registration. What it throws
  /// is logged.
  template <class T, class Callback>
  App& on_message(const Topic<T>& topic, Callback callback) {
    add_observer_spec(
        detail::topic_spec(topic),
        [callback = std::move(callback)](const void* message, std::uint64_t sequence) mutable {
          callback(*static_cast<const T*>(message), sequence);
        });
    return *this;
  }

  /// Called once per run when messages may be published, after every `init`: the place to start a
  /// driver. On the sources' thread, in the process that has the sources, also by `xauto profile`.
  App& on_start(std::function<void()> callback);
  /// Called once after each on_start, also when that threw or the run failed: no message is taken
  /// any more. The place to end a driver. On the same thread.
  App& on_stop(std::function<void()> callback);
  /// Called once after the last activation, when no message is taken any more and what every `init`
  /// made is destroyed. main() has not returned yet: it is the place to write results.
  App& on_end(std::function<void()> callback);

  /// Of a run with tables (docs/modes.md): from the next release on at least what scenario `name` covers
  /// counts; "": nobody asks any more. As `xauto param scenario` does. Threads: any, also a callback or an
  /// `exec`, in any process of the app. Errors: kNotFound: there is no such scenario; kUnavailable: no
  /// run goes on, or it has no tables.
  [[nodiscard]] Status request_mode(const std::string& name);

  /// In a run by priorities: from its next job on the XNode's jobs have this one; the larger goes first. No claim is made
  /// of the run any more, and its report says so. As `xauto prio` does. Threads: as request_mode. Errors: kNotFound:
  /// there is no such XNode; kInvalid: out of range, or the run is by keys; kUnavailable: no run goes on, nobody
  /// schedules it, or the XNode is on a real core under SCHED_FIFO, whose ranks are set before the run.
  [[nodiscard]] Status set_priority(const std::string& xnode, std::int64_t priority);
  /// The same in a run by keys: each job is to be done so long after its nominal release, 0 to 11 days.
  [[nodiscard]] Status set_key(const std::string& xnode, std::chrono::microseconds key);
  /// The policy's is back.
  [[nodiscard]] Status as_planned(const std::string& xnode);

  /// Everything that is wrong with the graph as declared: names each module, XNode and topic
  /// involved. Error: kInvalid.
  [[nodiscard]] Status check() const;

  /// Runs the app in this process and returns when the run is over; docs/api.md says what a process
  /// of its own gives and this does not. The daemons are child processes; signal handlers, stdin
  /// and stdout are left alone. May be called again after it has returned; two Apps may run at the
  /// same time. Threads: any; must not be called from an `init`, an `exec` or a callback.
  ///
  /// Errors:
  ///   kInvalid      options, files or the graph contradict each other;
  ///   kNotFound     a file, or the daemons' programs;
  ///   kUnavailable  it runs already, an `init` or a callback threw, or an `exec` of an earlier run
  ///                 never returned.
  /// What is lost in a run is no error, but in the report.
  [[nodiscard]] Result<RunReport> run(const RunOptions& options);
  /// Ends the run that is under way: no further releases, what is in flight is finished, then run()
  /// returns. Without a run nothing happens. Threads: any.
  void stop();

  /// The whole program: does what the `xauto` tool that started this process asks (run, profile,
  /// describe); started by hand it hands itself to `xauto run`. Returns the exit status.
  int main(int argc, char** argv);

 private:
  void add_module_spec(std::shared_ptr<detail::XModuleSpec> spec);
  void add_source_spec(detail::TopicHandle topic, std::chrono::microseconds period,
                       detail::Make make);
  void mark_source_spec(detail::Judge urgent);  ///< of the source that was added last
  void set_source_rate(Rate rate);              ///< likewise
  void add_deadline(detail::TopicHandle from, detail::TopicHandle to,
                    std::shared_ptr<detail::XModuleSpec> module, std::chrono::microseconds limit);
  void set_clock(detail::TopicHandle source, std::string name, int ppm);
  [[nodiscard]] std::shared_ptr<detail::Inlet> add_inlet(detail::TopicHandle topic,
                                                         std::chrono::microseconds distance);
  void add_observer_spec(detail::TopicHandle topic, detail::Observe observe);
  struct Data;
  std::shared_ptr<Data> data_;  ///< shared with threads that a run had to leave behind
};

}  // namespace xauto
