// The law of recordings: what was written is what is read, in file order and in the order of time.
#include "tests/recording/recording_support.hpp"

namespace weakgrid::mcap {
namespace {

std::vector<Entry> in_time_order(std::vector<Entry> entries) {
  std::stable_sort(entries.begin(), entries.end(),
                   [](const Entry& a, const Entry& b) { return a.log_time_ns < b.log_time_ns; });
  return entries;
}

TEST(McapRoundTripLaw, WhatIsWrittenIsReadInFileOrder) {
  const Folder folder;
  for (std::uint32_t seed = 0; seed < law_count(100); ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    const auto path = folder / std::to_string(seed).c_str();
    const Content written = write_file(path, seed, {}, small_chunks(compressions[seed % 3]));
    ScanReport report;
    ASSERT_TRUE(content_of(path, report) == written);
    ASSERT_TRUE(report.intact()) << report.text();
    ASSERT_EQ(report.messages, written.messages.size());
    const Bytes bytes = file_bytes(path);
    ASSERT_TRUE(content_of(ByteView{bytes}) == written) << "from memory as from the file";
    std::filesystem::remove(path);
  }
}

TEST(McapRoundTripLaw, TimeOrderIsStable) {
  const Folder folder;
  for (std::uint32_t seed = 0; seed < law_count(100); ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    const auto path = folder / std::to_string(seed).c_str();
    const Content written = write_file(path, seed, {}, small_chunks(compressions[seed % 3]));
    const auto expected = in_time_order(written.messages);
    ASSERT_TRUE(by_time(path) == expected);

    Random random{seed};
    ASSERT_FALSE(expected.empty());
    const auto& from = expected[below(random, expected.size())];
    const auto& until = expected[below(random, expected.size())];
    std::vector<Entry> part;
    for (const Entry& entry : expected)
      if (entry.log_time_ns >= from.log_time_ns && entry.log_time_ns <= until.log_time_ns &&
          entry.topic == from.topic)
        part.push_back(entry);
    ASSERT_TRUE(by_time(path, {from.log_time_ns, until.log_time_ns}, from.topic) == part);
    std::filesystem::remove(path);
  }
}

TEST(McapRoundTripLaw, TheSummaryTellsWhatAScanFinds) {
  const Folder folder;
  for (std::uint32_t seed = 0; seed < law_count(100); ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    const auto path = folder / std::to_string(seed).c_str();
    const Content written = write_file(path, seed, {}, small_chunks(compressions[seed % 3]));
    IndexedReader by_summary;
    ASSERT_TRUE(by_summary.open(path).ok());
    const Summary& summary = by_summary.summary();
    ASSERT_FALSE(summary.rebuilt);
    ASSERT_TRUE(summary.crc_checked);
    for (const MetadataIndex& index : summary.metadata)
      ASSERT_EQ(by_summary.metadata(index).value().entries, written.metadata.at(index.name));
    for (const AttachmentIndex& index : summary.attachments)
      ASSERT_EQ(by_summary.attachment(index).value().data, written.attachments.at(index.name));

    Bytes cut = file_bytes(path);
    cut.pop_back();
    IndexedReader by_scan;
    ASSERT_TRUE(by_scan.open(ByteView{cut}).ok());
    const Summary& scanned = by_scan.summary();
    ASSERT_TRUE(scanned.rebuilt);
    ASSERT_EQ(scanned.schemas, summary.schemas);
    ASSERT_EQ(scanned.channels, summary.channels);
    ASSERT_EQ(scanned.statistics.channel_messages, summary.statistics.channel_messages);
    ASSERT_EQ(scanned.statistics.messages, summary.statistics.messages);
    ASSERT_EQ(scanned.statistics.start_ns, summary.statistics.start_ns);
    ASSERT_EQ(scanned.statistics.end_ns, summary.statistics.end_ns);
    ASSERT_EQ(scanned.metadata.size(), summary.metadata.size());
    ASSERT_EQ(scanned.attachments.size(), summary.attachments.size());
    ASSERT_EQ(scanned.chunks.size(), summary.chunks.size());
    for (std::size_t k = 0; k < scanned.chunks.size(); ++k) {
      ASSERT_EQ(scanned.chunks[k].offset, summary.chunks[k].offset);
      ASSERT_EQ(scanned.chunks[k].length, summary.chunks[k].length);
      ASSERT_EQ(scanned.chunks[k].start_ns, summary.chunks[k].start_ns);
      ASSERT_EQ(scanned.chunks[k].end_ns, summary.chunks[k].end_ns);
      ASSERT_EQ(scanned.chunks[k].compression, summary.chunks[k].compression);
    }
    std::filesystem::remove(path);
  }
}

}  // namespace
}  // namespace weakgrid::mcap
