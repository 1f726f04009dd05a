// Stands in for libFuzzer where the compiler has none: runs a target on every file of its corpus
// and on random mutations of them, the same ones each time.
//
//   fuzz_replay TARGET CORPUS_FOLDER MUTATIONS

#include <algorithm>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <random>
#include <string>
#include <vector>

#include "tests/fuzz/fuzz.h"

// Of the sanitizers, where the program is built with them.
extern "C" void __sanitizer_set_death_callback(void (*callback)()) __attribute__((weak));

namespace splinemap {
namespace {

using Bytes = std::vector<uint8_t>;

constexpr size_t kMaxBytes = 4096;

Bytes current;

void KeepCurrent() {
  constexpr const char* kPath = "crash.input";
  std::ofstream(kPath, std::ios::binary)
      .write(reinterpret_cast<const char*>(current.data()), std::ssize(current));
  std::fprintf(stderr, "the input is kept in %s\n", kPath);
}

void OnSignal(int signal) {
  KeepCurrent();
  std::signal(signal, SIG_DFL);
  std::raise(signal);
}

void Run(FuzzRun run, Bytes input) {
  current = std::move(input);
  run({current.data(), current.size()});
}

std::vector<Bytes> ReadCorpus(const std::string& folder) {
  std::vector<std::filesystem::path> paths;
  for (const auto& entry : std::filesystem::directory_iterator(folder)) paths.push_back(entry);
  std::sort(paths.begin(), paths.end());  // so that each run is the same
  std::vector<Bytes> corpus;
  for (const auto& path : paths) {
    std::ifstream in(path, std::ios::binary);
    corpus.push_back({std::istreambuf_iterator<char>(in), {}});
  }
  return corpus;
}

class Mutator {
 public:
  explicit Mutator(const std::vector<Bytes>& corpus) : corpus_(corpus) {}

  Bytes Next() {
    Bytes bytes = corpus_[Below(corpus_.size())];
    for (size_t count = 1 + Below(4); count > 0; --count) Mutate(bytes);
    if (bytes.size() > kMaxBytes) bytes.resize(kMaxBytes);
    return bytes;
  }

 private:
  size_t Below(size_t bound) { return random_() % bound; }

  void Mutate(Bytes& bytes) {
    constexpr uint8_t kOddBytes[] = {0x00, 0x01, 0x7f, 0x80, 0xff};
    if (bytes.empty()) bytes.push_back(0);
    const size_t place = Below(bytes.size());
    const size_t length = std::min(bytes.size() - place, 1 + Below(8));
    const auto begin = bytes.begin() + static_cast<std::ptrdiff_t>(place);
    const auto end = begin + static_cast<std::ptrdiff_t>(length);
    switch (Below(6)) {
      case 0:
        *begin = static_cast<uint8_t>(*begin ^ (1 << Below(8)));
        break;
      case 1:
        *begin = static_cast<uint8_t>(random_());
        break;
      case 2:
        std::fill(begin, end, kOddBytes[Below(std::size(kOddBytes))]);
        break;
      case 3:
        bytes.erase(begin, end);
        break;
      case 4: {
        const Bytes copy(begin, end);
        bytes.insert(bytes.begin() + static_cast<std::ptrdiff_t>(Below(bytes.size())), copy.begin(),
                     copy.end());
        break;
      }
      case 5: {  // goes on as another file
        const Bytes& other = corpus_[Below(corpus_.size())];
        bytes.resize(place);
        const size_t from = Below(other.size() + 1);
        bytes.insert(bytes.end(), other.begin() + static_cast<std::ptrdiff_t>(from), other.end());
        break;
      }
    }
  }

  const std::vector<Bytes>& corpus_;
  std::mt19937_64 random_{1};
};

int Main(int argc, char** argv) {
  if (argc != 4) {
    std::fprintf(stderr, "usage: %s TARGET CORPUS_FOLDER MUTATIONS\n", argv[0]);
    return 2;
  }
  if (__sanitizer_set_death_callback != nullptr) __sanitizer_set_death_callback(&KeepCurrent);
  std::signal(SIGABRT, &OnSignal);
  const FuzzRun target = FindFuzzTarget(argv[1]);
  const std::vector<Bytes> corpus = ReadCorpus(argv[2]);
  Require(!corpus.empty(), "a corpus");
  for (const Bytes& bytes : corpus) Run(target, bytes);
  Mutator mutator(corpus);
  const long mutations = std::atol(argv[3]);
  for (long k = 0; k < mutations; ++k) Run(target, mutator.Next());
  std::printf("%zu files and %ld mutations of them ran\n", corpus.size(), mutations);
  return 0;
}

}  // namespace
}  // namespace splinemap

int main(int argc, char** argv) { return splinemap::Main(argc, argv); }
