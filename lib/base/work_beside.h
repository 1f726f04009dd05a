#pragma once

#include <cstddef>
#include <functional>
#include <mutex>
#include <stop_token>
#include <thread>
#include <utility>
#include <vector>

#include "lib/base/mutex.h"

namespace splinemap {

// A thread that works on items, one after the other, beside the one that makes them. So many wait
// at most; who makes more waits as well. Items keep their memory. A thread is woken for half of
// the items at once, so that the two rarely change places on a single core. What was not waited for
// may be left undone in the end. Thread-compatible.
template <typename Item>
class WorkBeside {
 public:
  // Requires at least one item.
  WorkBeside(size_t items, std::function<void(Item&)> work)
      : items_(items),
        work_(std::move(work)),
        thread_([this](const std::stop_token& stop) { Run(stop); }) {}

  // An item that is new or was worked on, as soon as there is one.
  Item& Next() {
    std::unique_lock lock(mutex_);
    if (added_ - done_ == items_.size()) {
      worked_.wait(lock, [this] { return added_ - done_ <= items_.size() / 2; });
    }
    return items_[added_ % items_.size()];
  }

  // Hands over what Next() gave.
  void Add() {
    const std::unique_lock lock(mutex_);
    ++added_;
    if (added_ - done_ >= items_.size() / 2) Wake();
  }

  // Until all that was handed over is worked on.
  void Wait() {
    std::unique_lock lock(mutex_);
    if (added_ != done_) Wake();
    worked_.wait(lock, [this] { return added_ == done_; });
  }

 private:
  void Wake() {
    if (!std::exchange(is_awake_, true)) woken_.notify_one();
  }

  void Run(const std::stop_token& stop) {
    std::unique_lock lock(mutex_);
    while (woken_.wait(lock, stop, [this] { return is_awake_; })) {
      while (added_ != done_) {
        Item& item = items_[done_ % items_.size()];
        lock.unlock();
        work_(item);
        lock.lock();
        ++done_;
        const size_t left = added_ - done_;
        if (left == 0 || left == items_.size() / 2) worked_.notify_one();
      }
      is_awake_ = false;
    }
  }

  std::vector<Item> items_;  // those from done_ to added_ are the worker's
  const std::function<void(Item&)> work_;
  Mutex mutex_;
  ConditionVariable woken_;
  ConditionVariable worked_;
  size_t added_ = 0;
  size_t done_ = 0;
  bool is_awake_ = false;
  std::jthread thread_;
};

}  // namespace splinemap
