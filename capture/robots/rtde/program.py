"""The control program: URScript that the client uploads, and the registers through which the two talk.

Registers are numbered from `FIRST` = 24: the controller's manual keeps 0 to 23 for field buses and gives 24 to 47 to RTDE clients.

    input_int_register_24       command, 0: none; see `Command`. It stands until the program has answered DONE, then goes back to 0
    input_double_register_24..  arguments. MOVE: six joint angles [rad], speed [rad/s], acceleration [rad/s^2]. STOP: deceleration
                                [rad/s^2]. WATCHDOG: lowest frequency at which the client writes the command register [Hz]
    input_int_register_25       1 with MOVE and STOP: answer before the motion ends
    output_int_register_24      state, READY: waits for a command; DONE: has carried one out and waits for command 0
    output_int_register_26      progress of the motion: bits 24-30 its number (0 to 127, then 0 again), 16-22 how often this register was
                                written, 15 whether it is under way
    output_double_register_24.. six results. TCP_OFFSET: position [m] and rotation vector [rad] of the tool in the flange

The numbers and their meaning are those of the vendor's control program, so that the simulated controller serves both alike. This program
answers STOP when the arm stands still. It takes no command before it has seen the register at 0: after a crash of the client the
controller may still hold an old one.

It uses documented functions only, those of PolyScope 5.6 and newer ("The URScript Programming Language for e-Series").
"""

from enum import IntEnum

FIRST = 24
READY, DONE = 1, 2
RUNNING_BIT = 1 << 15


class Command(IntEnum):
    """What the program can be asked to do."""

    NONE = 0
    MOVE = 1
    STOP = 34
    WATCHDOG = 35
    TCP_OFFSET = 40
    END = 255


_PROGRAM = """\
def koala_control():
  # int register offset
  offset = {first}
  # float register offset
  # the same
  global first = offset
  global target = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
  global speed = 0.1
  global acceleration = 0.1
  global motion = 0
  global moving = False
  global arrived = False
  global number = 0
  global writes = 0

  thread follow():
    movej(target, a=acceleration, v=speed)
    arrived = True
  end

  def argument(index):
    return read_input_float_register(first + index)
  end

  def report():
    writes = writes + 1
    if writes > 127:
      writes = 0
    end
    local progress = number * 16777216 + writes * 65536
    if moving:
      progress = progress + {running}
    end
    write_output_integer_register(first + 2, progress)
  end

  def halt(deceleration):
    if moving:
      if not arrived:
        kill motion
      end
      stopj(deceleration)
      moving = False
      report()
    end
  end

  def start_move():
    halt(argument(7))
    target = [argument(0), argument(1), argument(2), argument(3), argument(4), argument(5)]
    speed = argument(6)
    acceleration = argument(7)
    number = number + 1
    if number > 127:
      number = 0
    end
    arrived = False
    moving = True
    report()
    motion = run follow()
  end

  def report_tcp_offset():
    local offset_pose = get_tcp_offset()
    local index = 0
    while index < 6:
      write_output_float_register(first + index, offset_pose[index])
      index = index + 1
    end
  end

  report()
  write_output_integer_register(first, 0)
  while read_input_integer_register(first) != 0:
    sync()
  end
  global executed = False
  global command = 0
  while command != {end}:
    if moving:
      if arrived:
        moving = False
        report()
      end
    end
    if command == 0:
      executed = False
      write_output_integer_register(first, {ready})
    elif not executed:
      executed = True
      if command == {move}:
        start_move()
      elif command == {stop}:
        halt(argument(0))
      elif command == {watchdog}:
        rtde_set_watchdog("input_int_register_{first}", argument(0), "stop")
      elif command == {tcp_offset}:
        report_tcp_offset()
      end
      write_output_integer_register(first, {done})
    end
    sync()
    command = read_input_integer_register(first)
  end
  halt(3.0)
end
"""


def text() -> str:
    """The program, ready to be sent to the script port."""
    commands = {command.name.lower(): int(command) for command in Command}
    return _PROGRAM.format(first=FIRST, running=RUNNING_BIT, ready=READY, done=DONE, **commands)
