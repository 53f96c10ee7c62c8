"""The control program: URScript that the client uploads, and the registers through which the two talk.

Registers are numbered from `FIRST` = 24: the controller reserves 0 to 23 for field buses and leaves 24 to 47 to RTDE clients.

    input_int_register_24       command, see `Command`. The client sets it back to 0 after the program has answered DONE
    input_int_register_25       1: answer MOVE and STOP at once; read by the simulated controller only
    input_double_register_24..  arguments. MOVE: six joint angles [rad], speed [rad/s], acceleration [rad/s^2].
                                STOP: deceleration [rad/s^2]. WATCHDOG: minimum rate of writing the command register [Hz].
                                TEACH, END_TEACH (freedrive on and off): none
    output_int_register_24      state. 0: starting; READY: waiting for a command; DONE: command executed, waiting for 0
    output_int_register_26      the latest motion. Bits 24-30: its number (0 to 127, then 0 again); 16-22: how often this register
                                was written; 15: set while the motion is under way
    output_double_register_24.. six results. TCP_OFFSET: position [m] and rotation vector [rad] of the tool in the flange

Numbers and meaning are those of the vendor's control program, so that the simulated controller serves both. MOVE is answered at
once, STOP when the arm stands still. No command is accepted before the register was 0: the controller may still hold the command
of a client that crashed. The watchdog stops the program, and with it the arm, when the command register is not written in time.

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
    TEACH = 18
    END_TEACH = 19
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

  def come_to_rest(deceleration):
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
    come_to_rest(argument(7))
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
        come_to_rest(argument(0))
      elif command == {teach}:
        come_to_rest(3.0)
        freedrive_mode()
      elif command == {end_teach}:
        end_freedrive_mode()
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
  come_to_rest(3.0)
end
"""


def text() -> str:
    """The program, ready to be sent to the controller."""
    commands = {command.name.lower(): int(command) for command in Command}
    return _PROGRAM.format(first=FIRST, running=RUNNING_BIT, ready=READY, done=DONE, **commands)
