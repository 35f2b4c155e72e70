"""Time and what happens at a time.

One unit is 1/672 us: every clock of the board (168, 84, 42, 16 and 8 MHz, 32 kHz) has a period of whole units."""

import heapq

UNITS_PER_US = 672
NEVER = 1 << 62


def units(us):
    """Microseconds as units, rounded."""
    return round(us * UNITS_PER_US)


class Alarm:
    """One callback at one settable time."""

    __slots__ = ("_queue", "callback", "time", "_serial")

    def __init__(self, queue, callback):
        self._queue, self.callback, self.time, self._serial = queue, callback, NEVER, 0

    def set(self, time):
        """Calls back at `time`; moves an alarm that is already set; NEVER cancels."""
        if time == self.time:
            return
        self.time = time
        if time < NEVER:
            self._queue.push(self)
        else:
            self._serial = 0

    def cancel(self):
        self.set(NEVER)


class Events:
    """The queue of alarms. Equal times fire in the order in which they were set."""

    def __init__(self, on_earlier):
        """`on_earlier(time)` is told of each new earliest alarm, so that a running core can stop in time."""
        self._heap, self._serial, self._on_earlier = [], 0, on_earlier

    def alarm(self, callback):
        return Alarm(self, callback)

    def at(self, time, callback):
        """A one-off."""
        alarm = Alarm(self, callback)
        alarm.set(time)
        return alarm

    def push(self, alarm):
        self._serial += 1
        alarm._serial = self._serial
        heapq.heappush(self._heap, (alarm.time, self._serial, alarm))
        if self._heap[0][1] == self._serial:
            self._on_earlier(alarm.time)

    def next_time(self):
        heap = self._heap
        while heap:
            time, serial, alarm = heap[0]
            if alarm._serial == serial and alarm.time == time:
                return time
            heapq.heappop(heap)
        return NEVER

    def fire_one(self):
        """Calls the earliest alarm back, which `next_time` has just found."""
        _, _, alarm = heapq.heappop(self._heap)
        alarm.time, alarm._serial = NEVER, 0
        alarm.callback()
