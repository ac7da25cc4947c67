from rollout_forecaster.forecaster import SLOWEST, Tried, propose

from phyagentos.protocol.sessions.strategy import Strategy


def tried(cause, share=0.0, grasp="yaw+090", site="site4.yaw+045", **strategy):
    return Tried(strategy=Strategy(**strategy), share=share, cause=cause, grasp=grasp, site=site)


def test_what_slips_is_carried_slower_then_slower_still():
    first = tried("GRASP_LOST", 0.2)
    second = tried("GRASP_LOST", 0.4, speed=0.5)

    assert propose([first]) == Strategy(speed=0.5)
    assert propose([first, second]) == Strategy(speed=0.25)


def test_the_next_way_is_a_remedy_for_the_best_one_so_far():
    first, worse = tried("LOAD_LOST", 0.5), tried("LOAD_LOST", 0.1, speed=0.5)

    assert propose([first, worse]) == Strategy(avoid_grasps=("yaw+090",))


def test_what_falls_from_its_place_is_put_elsewhere_and_not_only_turned():
    assert propose([tried("PLACED_WRONG")]) == Strategy(avoid_sites=("site4",))


def test_what_knocks_over_a_neighbour_comes_from_another_side_first():
    assert propose([tried("OBJECT_MOVED")]) == Strategy(avoid_sites=("site4.yaw+045",))


def test_a_grasp_from_which_nothing_can_be_planned_is_avoided():
    assert propose([tried("NO_IK", site="")]) == Strategy(avoid_grasps=("yaw+090",))


def test_what_is_avoided_already_stays_avoided():
    first = tried("GRASP_MISSED", avoid_grasps=("yaw+000",), speed=0.5)

    assert propose([first]) == Strategy(avoid_grasps=("yaw+000", "yaw+090"), speed=0.5)


def test_when_everything_was_tried_nothing_is_proposed():
    slowest = tried("STALLED", speed=SLOWEST)

    assert propose([slowest]) is None
    assert propose([tried("UNHEARD_OF")]) is None
