// SPDX-License-Identifier: Apache-2.0
// A suspended job may hold up a more urgent one on another XPU, or on its own: one whose exec waits
// for work that an exec before it has left in its queue (a CUDA IPC event, a hybrid cuDLA task, a
// semaphore of a channel). No schedule knows of that wait, so nothing would end it but the end of
// whoever has the XPU. The rule for apps is in docs/api.md: what a stage leaves behind is over when
// its exec returns. This is for apps that break it.
//
// What can be seen: the job of a stage that comes after the suspended one in the graph runs, is more
// urgent, and makes no progress: it is at it for far longer than its WCET. Then the suspended job
// goes by the other's key until it ends (priority inheritance), so it is resumed unless something
// more urgent still has its XPU. It is told, and counted; no worst case holds any more.
//
// A job on a real CPU may be preempted unseen: it counts only once it is past its own key, which
// policies of priorities do not have.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <xauto/result.h>

#include "coord/observer.h"
#include "grid/context.h"
#include "runtime/placing.h"

namespace xauto::runtime {

inline constexpr std::int64_t kHeldUpLookNs = 10'000'000;  ///< between looks at what a job holds up
/// For how long a job of this WCET must have run: twice that, so that an overrun alone is no reason,
/// and what the threads around it may take on a busy machine.
constexpr std::int64_t held_up_after_ns(std::int64_t wcet_ns) {
  return 2 * wcet_ns + 5'000'000;
}

/// Of one process. Any thread.
class HeldUp {
 public:
  /// Where to read what runs. Not an error: that a coordinator does not tell.
  HeldUp(const Context& context, const Placing& placing);

  struct Waits {
    std::uint32_t xnode;
    coord::Key key;
  };
  /// One suspension, as the management thread sees it.
  class Watch {
   public:
    /// Of a job of graph node `node`.
    Watch(const HeldUp& all, int node, std::int64_t now_ns);
    /// The most urgent of those that it holds up and that are more urgent than `key`. To be called
    /// every kHeldUpLookNs; what lies between two calls counts as twice that at most, so that a
    /// machine that stood still is nobody's fault.
    [[nodiscard]] std::optional<Waits> look(std::int64_t now_ns, coord::Key key);

   private:
    struct Sight {
      std::size_t xpu;
      int slot;
      std::uint32_t generation;
      std::int64_t ran_ns;  ///< since it was first seen, at least
      bool still;           ///< at this look
    };
    Sight& sight(std::size_t xpu, const coord::Observer::Running& job);

    const HeldUp& all_;
    const int node_;
    std::vector<char> later_;  ///< [XNode] comes after it; empty: not looked for yet
    std::int64_t looked_ns_;
    std::vector<Sight> sights_;
    std::vector<coord::Observer::Running> running_;
  };

  [[nodiscard]] const std::string& name(std::uint32_t xnode) const { return names_[xnode]; }

 private:
  [[nodiscard]] std::vector<char> after(int node) const;

  const Graph& graph_;
  const bool by_keys_;
  std::vector<std::unique_ptr<coord::Observer>> xpus_;  ///< null: unused, or nobody tells
  std::vector<std::uint32_t> xnode_;                    ///< [graph node]
  std::vector<std::int64_t> wcet_ns_;                   ///< [task] where it is placed
  std::vector<std::string> names_;                      ///< [XNode]
};

}  // namespace xauto::runtime
