"""Two sensors at once: paired by time, recorded, and the truth of a live translation."""

from __future__ import annotations

import math
from contextlib import ExitStack, closing

import cv2
import foxglove
import numpy as np
import pytest
from foxglove.channels import RawImageChannel

import tactoscope as ts
from pipeline.cli.main import EXIT_USER_ERROR, build_app, run_app
from pipeline.core.errors import TouchError
from pipeline.core.values.pairing import NO_PARTNER, pair_frames
from pipeline.io import open_recording
from pipeline.io.live import reader as live_reader
from pipeline.io.live.paired_reader import PairedReader, make_reader
from pipeline.io.live.recorder import LiveRecorder
from pipeline.io.live.source_parsing import parse_sources
from pipeline.sensors.spec import load_sensor
from pipeline.translation import live_translation
from tests.pipeline.io.live.streams import (
    make_coloured,
    make_raw,
    publishing,
    serve_mjpeg,
    wait_until,
)

SHAPE = load_sensor("digit").camera.shape
RATE_HZ = 30.0
N_SETTLING = 30  # frames until both clocks are known well
LOST = 61  # of a hundred moments, that one of the two does not show
OTHER_LOST = 80


@pytest.mark.parametrize("every", [1, 2])
def test_two_bridges_are_paired_by_moment_whatever_their_clocks_say(every):
    """Of the same rate or half of it, each losing 1 %, one clock an hour ahead."""

    def show(channel, moment, start_s):
        image = make_coloured(SHAPE)
        image[0, 0, :2] = divmod(moment, 100)
        channel.log(make_raw(image, "rgb8", start_s + moment / RATE_HZ))

    def publish(moment):
        if moment % 100 != LOST:
            show(channels[0], moment, 1000.0)
        if moment % 100 != OTHER_LOST and moment % every == 0:
            show(channels[1], moment, 4600.0)

    def read_moment(frame):
        return int(frame.image[0, 0, 0]) * 100 + int(frame.image[0, 0, 1])

    with ExitStack() as stack:
        channels = []
        addresses = []
        contexts = foxglove.Context(), foxglove.Context()
        for name, context in zip(("/left", "/right"), contexts, strict=True):
            server = foxglove.start_server(host="127.0.0.1", port=0, context=context)
            stack.callback(server.stop)
            channels.append(RawImageChannel(name, context=context))
            addresses.append(f"ws://127.0.0.1:{server.port}")
        sources = parse_sources(
            addresses[:1], addresses[1:], sensor="digit", partner_sensor="digit"
        )
        reader = make_reader(*sources)
        reader.start()
        stack.callback(reader.stop, 10.0)
        stack.enter_context(publishing(publish, 1 / RATE_HZ))
        wait_until(lambda: reader.status().partner and reader.n_frames > N_SETTLING + 105)
        reader.stop(10.0)
        status = reader.status()
        one, other = reader.make_streams()
    assert (one.name, other.name) == ("digit", "digit_2")
    partners = pair_frames(one, other).partners
    moments = [read_moment(one.frame(i)) for i in range(one.n_frames)]
    last = read_moment(other.frame(other.n_frames - 1))
    for moment, partner in list(zip(moments, partners, strict=True))[N_SETTLING:]:
        if moment % 100 == OTHER_LOST or moment % every:
            assert partner == NO_PARTNER
        elif moment < last:
            assert read_moment(other.frame(partner)) == moment
    assert not any(moment % 100 == LOST for moment in moments)
    gaps = moments[-1] - moments[0] + 1 - len(moments)
    assert 0 < status.n_lost <= gaps
    assert status.partner.n_lost > 0
    assert status.n_unpaired >= (1 if every == 1 else 30)


def test_a_partner_that_dies_and_returns_is_said_and_both_are_recorded(tmp_path, monkeypatch):
    monkeypatch.setattr(live_reader, "RETRY_S", 0.01)
    images = [make_coloured(SHAPE, grey) for grey in (110, 120)]
    path = tmp_path / "both.h5"
    with serve_mjpeg(images) as (address, _), serve_mjpeg(images) as (other, other_ended):
        reader = make_reader(*parse_sources([address], [other], sensor="digit", target="digit"))
        recorder = LiveRecorder(path, reader)
        reader.start()
        wait_until(lambda: recorder.n_written > 20)
        with closing(open_recording(path)) as growing:
            assert [stream.name for stream in growing.streams] == ["digit", "digit_2"]
        assert reader.status().message == ""
        other_ended.set()
        wait_until(lambda: reader.status().message.startswith("partner: "))
        n = reader.n_frames
        n_unpaired = reader.status().n_unpaired
        wait_until(lambda: reader.n_frames > n + 20)
        assert reader.status().n_unpaired > n_unpaired
        assert reader.find_partner(reader.n_frames - 1) is None
        assert reader.find_partner(10**6) is None
        assert "without a partner; partner lost" in reader.status().describe()
        other_ended.clear()
        wait_until(lambda: reader.status().message == "")
        wait_until(lambda: reader.find_partner(reader.n_frames - 1) is not None)
        assert reader.stop(20.0)
        assert recorder.close()
    with closing(open_recording(path)) as recording:
        one, other = recording.streams
        assert one.n_frames + other.n_frames == recorder.n_written
        paired = pair_frames(one, other).indices
        assert 0 < len(paired) < one.n_frames


@pytest.mark.timeout(300)
def test_what_the_targets_own_sensor_takes_is_the_truth_of_a_live_translation():
    for shown in ts.live("simulated", "soft_bubble", sensor="gelslim", partner="simulated"):
        if shown.truth.target_observation is None or shown.results["depth"].state == "skipped":
            continue
        recorded = shown.truth.target_observation
        assert recorded.sensor == "soft_bubble"
        assert recorded.time_s == pytest.approx(shown.frame.time_s, abs=1 / RATE_HZ)
        error_mm = shown.metrics["touch.depth_mae_mm"]
        generated = shown.results["touch"].output.image
        assert error_mm == pytest.approx(float(np.nanmean(np.abs(generated - recorded.image))))
        assert error_mm < 1.0 < float(np.nanmax(recorded.reference - recorded.image))
        break


def test_a_partner_that_is_not_there_ends_a_loop_and_a_recording_with_its_sentence(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.setattr(live_translation, "_PATIENCE_S", 0.1)
    gone = f"folder {tmp_path / 'gone'}"
    place = tmp_path / "growing"
    place.mkdir()
    path = tmp_path / "a.h5"
    image = make_coloured(SHAPE)[..., ::-1]
    with publishing(lambda n: cv2.imwrite(str(place / f"{n:06}.png"), image), 0.05):
        with pytest.raises(TouchError, match=r"partner: there is no folder '[^']*gone'$"):
            next(ts.live(f"folder {place}", "gelslim", sensor="digit", partner=gone))
        words = ["--source", f"folder {place}", "--sensor", "digit", "--partner", gone]
        assert run_app(build_app(), ["live", *words, "--record", str(path), "--seconds", "3"]) == 1
    assert "no file is left: partner: there is no folder" in capsys.readouterr().out
    assert not path.exists()


def test_one_sensor_has_no_partner():
    source, partner = parse_sources(["simulated"], [""])
    assert partner is None
    assert not isinstance(make_reader(source), PairedReader)
    assert math.isinf(make_reader(source).newest_s)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--source", "camera:0", "--partner", "camera:0", "--sensor", "digit"], "name the other"),
        (["--source", "camera:0", "--partner", "simulated"], "both real or both simulated"),
        (
            ["--partner", "camera:1", "--partner-sensor", "digit", "--target", "soft_bubble"],
            "--target digit",
        ),
        (["--partner", "a wish"], "a source is simulated"),
    ],
)
def test_a_partner_that_cannot_be_one_is_a_sentence_with_a_remedy(words, said, capsys):
    assert run_app(build_app(), ["live", "--seconds", "1", *words]) == EXIT_USER_ERROR
    assert said in capsys.readouterr().err
