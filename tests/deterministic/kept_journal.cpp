// KeptJournal: see the header.
#include "tests/deterministic/kept_journal.hpp"

#include <unistd.h>

#include <algorithm>
#include <filesystem>
#include <nlohmann/json.hpp>

#include "services/journal/journal.hpp"
#include "tests/deterministic/tape.hpp"

namespace weakgrid::deterministic {

namespace {
constexpr std::uint32_t unit = 1;

std::string name_of(const nlohmann::json& client, const nlohmann::json& id, const nlohmann::json& step) {
  return client.dump() + " " + id.dump() + " " + step.dump();
}

// As it comes back from a line: what a number cannot say is a text there.
std::string as_read(const nlohmann::json& body) {
  const auto line = journal_line(1, 0, "any", body, journal_beginning());
  const auto entry = parse_journal_line(std::string_view(line->bytes).substr(0, line->bytes.size() - 1));
  return entry->body.dump();
}

// In memory if there is such a place: a run opens and syncs many times.
std::filesystem::path folder() {
  const std::filesystem::path memory = "/dev/shm";
  return access(memory.c_str(), W_OK) == 0 ? memory : std::filesystem::temp_directory_path();
}
}  // namespace

KeptJournal::KeptJournal(std::uint64_t seed)
    : path_(folder() / ("weakgrid_deterministic_" + std::to_string(getpid()) + "_" + std::to_string(seed))) {}

KeptJournal::~KeptJournal() {
  journal_.reset();
  std::filesystem::remove(path_);
  for (int n = 1; std::filesystem::remove(path_ + ".torn-" + std::to_string(n)); ++n) {
  }
}

GatewayMemory KeptJournal::open() {
  journal_ = std::make_unique<Journal>(path_);
  check();
  const GatewayMemory memory = recall(path_, unit);
  const auto known = memory.reference ? issued_.find(memory.reference->id) : issued_.end();
  if (known != issued_.end() && bits_of(known->second) != bits_of(*memory.reference))
    throw Violation{memory.step, "the journal tells of another reference than was issued"};
  // What it holds beyond this file's entries, a line "recovered", comes before whatever is kept next.
  return memory;
}

void KeptJournal::keep(std::string_view kind, const nlohmann::json& body, Time now) {
  const Entry entry{std::string(kind), as_read(body), 0, now};
  if (is_late_)
    late_.emplace_back(entry, body);
  else
    append(entry, body);
}

void KeptJournal::append(const Entry& entry, const nlohmann::json& body) {
  if (!journal_->append(entry.kind, body))
    throw Violation{0, "the journal refuses an entry: " + journal_->fault()};
  entries_.push_back(entry);
  entries_.back().end = std::filesystem::file_size(path_);
}

void KeptJournal::flush() {
  for (const auto& [entry, body] : late_) append(entry, body);
  late_.clear();
}

void KeptJournal::see_told(const Decision& d) {
  if (!d.repeated && d.kind != RequestKind::revalidate)
    told_.push_back({name_of(d.client, d.id, d.decided_step), entries_.size()});
}

void KeptJournal::see_issued(const Reference& reference) {
  issued_[reference.id] = reference;
  last_order_ = reference;
}

void KeptJournal::close() {
  late_.clear();
  journal_.reset();
}

void KeptJournal::cut_power(Dice& dice, Time now) {
  close();
  const auto synced = static_cast<std::size_t>(std::count_if(
      entries_.begin(), entries_.end(), [&](const Entry& e) { return e.kept < now - sync_max; }));
  const std::size_t left = synced + dice.below(entries_.size() - synced + 1);
  std::uint64_t end = left == 0 ? 0 : entries_[left - 1].end;
  if (left < entries_.size()) {
    // From here to the end of the next whole line, short of its newline.
    const double torn = dice.chance(0.5) ? dice.uniform(0.0, 1.0) : 0.0;
    end += static_cast<std::uint64_t>(torn * static_cast<double>(entries_[left].end - end - 1));
    std::filesystem::resize_file(path_, end);
  }
  entries_.resize(left);
  std::erase_if(told_, [&](const Told& t) { return t.entries > left; });
  last_order_.reset();
}

// Every entry that was kept, in order, and nothing else but what the journal says of itself; every decision
// that somebody has heard of among them.
void KeptJournal::check() const {
  std::size_t n = 0;
  std::set<std::string> decisions;
  const JournalVerdict verdict = read_journal(path_, [&](const JournalEntry& entry, const JournalPlace&) {
    if (entry.kind == "recovered") return;
    if (n >= entries_.size() || entry.kind != entries_[n].kind || entry.body.dump() != entries_[n].body)
      throw Violation{0, "entry " + std::to_string(entry.n) + " of the journal is not what was kept there"};
    ++n;
    if (entry.kind == "decision" && entry.body.contains("request"))
      decisions.insert(name_of(entry.body["client"], entry.body["request"]["id"], entry.body["step"]));
  });
  if (!verdict.intact()) throw Violation{0, "the journal is broken: " + verdict.text()};
  if (n != entries_.size())
    throw Violation{0, std::to_string(entries_.size() - n) + " entries are lost that were kept"};
  for (const Told& told : told_)
    if (decisions.count(told.decision) == 0)
      throw Violation{0, "a decision was heard of and is not in the journal: " + told.decision};
}

}  // namespace weakgrid::deterministic
