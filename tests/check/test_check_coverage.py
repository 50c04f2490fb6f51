"""Streams that begin late or end early, beside those that last as long as the others."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st
from recording_data import recording

from slamsim.check.evidence import RecordingEvidence
from slamsim.check.questions.streams.coverage import check_coverage
from slamsim.recording import RawImu, RawOdometry, RawScans
from slamsim.recording.edits.messages import select


@settings(max_examples=30)
@given(
    seconds=st.sampled_from([30.0, 90.0, 200.0]),
    begin=st.floats(0.0, 0.4),
    end=st.floats(0.6, 1.0),
    kind=st.sampled_from([RawScans, RawImu, RawOdometry]),
)
def test_what_is_missing_is_measured_in_seconds(
    seconds: float, begin: float, end: float, kind: type[RawScans | RawImu | RawOdometry]
) -> None:
    whole = recording(seconds)
    (stream,) = whole.of(kind)
    at = (stream.stamps_ns - stream.stamps_ns[0]) * 1e-9 / seconds
    part = whole.with_streams(kind, (select(stream, (at >= begin) & (at <= end)),))
    found = {one.subject: one for one in check_coverage(RecordingEvidence(part))}
    limit_s = max(10.0, 0.1 * seconds)
    missing_s = seconds * max(begin, 1.0 - end)
    if abs(missing_s - limit_s) > 0.3:  # periods of the streams
        assert found[stream.topic].fault == ("stream_cut" if missing_s > limit_s else None)
    others = [one for topic, one in found.items() if topic != stream.topic]
    assert len(others) >= 2
    assert all(one.verdict == "ok" for one in others)
