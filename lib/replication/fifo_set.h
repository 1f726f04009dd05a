#pragma once

#include <cstddef>
#include <deque>
#include <utility>

#include "absl/container/flat_hash_set.h"

namespace splinemap {

// A queue that holds each element once. Thread-compatible.
template <typename T>
class FifoSet {
 public:
  bool empty() const { return queue_.empty(); }
  size_t size() const { return queue_.size(); }

  // Goes to the end, unless it is there already.
  void Push(T element) {
    if (elements_.insert(element).second) queue_.push_back(std::move(element));
  }
  // Requires !empty().
  T Pop() {
    T element = std::move(queue_.front());
    queue_.pop_front();
    elements_.erase(element);
    return element;
  }

 private:
  std::deque<T> queue_;
  absl::flat_hash_set<T> elements_;
};

}  // namespace splinemap
