"""The numerical stability matrix: what must hold for every input that a person, a file or a sensor
can produce.

Each test is a row, named by its property, and checks it for as many cases as `--cases` says. Left
away it is the short form, which `make test` runs; `make stability` asks for 10,000 and leaves a
table in out/stability.json. A row whose cases are slow takes the share that it states (5,000 for
the chain without a pose, 20 to 3,000 where a membrane is pressed or light is read, 10 to 200 where
a pose is registered), one over listed cases as many as there are. The table shows true numbers, and
how often the answer was a refusal, which is bounded.

| no. | property | module |
|---|---|---|
| 1 | to the target and back is where it was | test_round_trip |
| 2, 5 | moving both frames, by up to 1e6 mm, changes nothing but the rounding | test_moved_frames |
| 3 | the order of points changes nothing | test_permutation |
| 4 | another unit of length is another number, nothing else | test_units |
| 6 | the type of the numbers changes nothing but the rounding | test_number_types |
| 7 | NaN, infinite, zero, negative, denormal: masked or a typed error, in the same time | test_poison |
| 8 | the degenerate touch: nothing, one pixel, all of them, flat, round, no volume | test_degenerate |
| 9 | any camera, any angle, any distance | test_cameras |
| 10 | what the data do not determine is named, frozen, and only that | test_conditioning |
| 11 | rotations at and near nothing and a half turn | test_rotations |
| 12 | networks and the paper's poses at the ends of their parameters, on pictures that no touch makes: finite, in range, or refused | test_learned |
| 13 | contact: no pull, no overlap, no force through a gap | test_contact |
| 15 | the same input gives the same bytes, whatever the number of threads | test_determinism |
| 16 | frame after frame through the whole chain | test_soak |

Row 14 (SiLog loss) is tests/pipeline/lab/training/test_silog_loss.py. Contact against closed forms
is in tests/pipeline/physics/test_closed_forms.py, random presses of the simulator are in
test_random_presses.
"""
