// SPDX-License-Identifier: Apache-2.0
// DisjunctiveGraph: a schedule that keeps a fixed order on every XPU (ordered.h), as a graph with
// the longest path to and from each XNode. The tabu search (tabu.h) asks it what a move would do.
//
//   head(i)  longest path that ends where i starts; tail(i)  longest path from i's end on
//   i is critical if head + wcet + tail is the makespan
//
// An XNode's predecessors are those of the app and the one before it on its XPU. Threads: one
// owner. Units: microseconds.
#pragma once

#include <vector>

#include "solver/problem.h"

namespace xauto::solver {

class DisjunctiveGraph {
 public:
  explicit DisjunctiveGraph(const Problem& problem);

  /// `sequence`: any permutation; where it contradicts the edges of the app, they win.
  void reset(const std::vector<int>& xpu, const std::vector<int>& sequence);
  /// Takes `xnode` from its XPU and puts it on `xpu`, before the one that is `place`-th there once
  /// it has left. update() is due afterwards.
  void move(int xnode, int xpu, std::size_t place);
  /// Heads, tails and makespan. False: the orders contradict each other, and nothing is known.
  [[nodiscard]] bool update();

  [[nodiscard]] Time makespan() const { return makespan_; }
  [[nodiscard]] const std::vector<int>& xpu() const { return xpu_; }
  /// All XNodes in an order that keeps edges and XPUs.
  [[nodiscard]] const std::vector<int>& sequence() const { return sequence_; }
  [[nodiscard]] const std::vector<int>& on(int xpu) const {
    return on_[static_cast<std::size_t>(xpu)];
  }
  [[nodiscard]] std::size_t place(int xnode) const { return place_[index(xnode)]; }
  [[nodiscard]] Time work(int xnode) const { return work_[index(xnode)]; }
  [[nodiscard]] Time head(int xnode) const { return head_[index(xnode)]; }
  [[nodiscard]] Time tail(int xnode) const { return tail_[index(xnode)]; }
  /// When the XNode is done at the earliest; what is left at the least once it starts.
  [[nodiscard]] Time done(int xnode) const { return head(xnode) + work(xnode); }
  [[nodiscard]] Time left(int xnode) const { return tail(xnode) + work(xnode); }
  /// The same by the edges of the app alone: who comes next to it on its XPU does not count.
  [[nodiscard]] Time ready(int xnode) const { return ready_[index(xnode)]; }
  [[nodiscard]] Time behind(int xnode) const { return behind_[index(xnode)]; }
  [[nodiscard]] bool critical(int xnode) const {
    return head(xnode) + work(xnode) + tail(xnode) == makespan_;
  }
  /// A successor by edge that is critical and starts when `xnode` ends; -1: none.
  [[nodiscard]] int critical_successor(int xnode) const;

  // What is certain not to close a cycle. `from` and `to` are places on one XPU.
  [[nodiscard]] bool may_follow(int xpu, std::size_t from, std::size_t to) const;
  [[nodiscard]] bool may_precede(int xpu, std::size_t from, std::size_t to) const;
  /// Places on `xpu`, one that it is not on, where `xnode` may go: from first to last, none if
  /// first > last. Places that are no better than these are left out.
  struct Places {
    std::size_t first, last;
  };
  [[nodiscard]] Places places(int xnode, int xpu) const;

  // Longest path through what a move touches, by the heads and tails before it: an estimate of the
  // makespan after it.
  /// The `from`-th of `xpu` goes right after the `to`-th, or right before it if `to` < `from`.
  [[nodiscard]] Time after_shift(int xpu, std::size_t from, std::size_t to);
  [[nodiscard]] Time after_insertion(int xnode, int xpu, std::size_t place) const;

 private:
  [[nodiscard]] static std::size_t index(int xnode) { return static_cast<std::size_t>(xnode); }

  const Problem& problem_;
  std::size_t n_;
  std::vector<int> succ_begin_, succ_, pred_begin_, pred_;  // adjacency, flat
  std::vector<int> xpu_, sequence_;
  std::vector<std::vector<int>> on_;
  std::vector<std::size_t> place_;
  std::vector<Time> work_, head_, tail_, ready_, behind_;
  std::vector<int> missing_;
  std::vector<int> segment_;
  std::vector<Time> segment_head_;
  Time makespan_ = 0;
};

}  // namespace xauto::solver
