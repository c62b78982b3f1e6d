// SPDX-License-Identifier: Apache-2.0
// A queue that keeps its memory: it grows to the longest that it ever was and then allocates no
// more, so that it may be used on the hot path.
#pragma once

#include <cstddef>
#include <utility>
#include <vector>

namespace xauto {

/// Threads: none of its own; whoever owns it locks.
template <class T>
class Ring {
 public:
  [[nodiscard]] bool empty() const { return size_ == 0; }
  [[nodiscard]] std::size_t size() const { return size_; }
  /// Of a ring that is not empty.
  [[nodiscard]] T& front() { return items_[first_]; }
  [[nodiscard]] const T& front() const { return items_[first_]; }

  /// Item `i` from the front; below `size()`.
  [[nodiscard]] T& operator[](std::size_t i) { return items_[(first_ + i) & (items_.size() - 1)]; }

  /// `item` is none of this ring's own.
  void push_back(const T& item) { room() = item; }
  void push_back(T&& item) { room() = std::move(item); }
  /// pop_front, with the item moved into `into`.
  void take_front(T& into) {
    into = std::move(items_[first_]);
    first_ = (first_ + 1) & (items_.size() - 1);
    --size_;
  }
  /// What the item held is let go at once.
  void pop_front() {
    items_[first_] = T();
    first_ = (first_ + 1) & (items_.size() - 1);
    --size_;
  }
  void clear() {
    while (!empty()) pop_front();
  }

 private:
  /// A new last item.
  T& room() {
    if (size_ == items_.size()) grow();
    return items_[(first_ + size_++) & (items_.size() - 1)];
  }
  void grow() {
    std::vector<T> larger(items_.empty() ? 1 : items_.size() * 2);
    for (std::size_t i = 0; i < size_; ++i)
      larger[i] = std::move(items_[(first_ + i) & (items_.size() - 1)]);
    items_ = std::move(larger);
    first_ = 0;
  }

  std::vector<T> items_;  ///< a power of two of them, or none
  std::size_t first_ = 0, size_ = 0;
};

}  // namespace xauto
