// Stand-in for px4_platform_common/module.h of PX4 up to 1.16: signatures of what the example uses.
#pragma once

#define __EXPORT __attribute__((visibility("default")))

template<class T>
class ModuleBase
{
public:
	virtual ~ModuleBase() = default;
	static int main(int argc, char *argv[])
	{
		return argc > 1 ? T::task_spawn(argc, argv) : T::custom_command(argc, argv);
	}
	static int run_trampoline(int argc, char *argv[])
	{
		T *object = T::instantiate(argc, argv);
		object->run();
		delete object;
		return 0;
	}
	virtual int print_status();
	virtual void run() {}

protected:
	bool should_exit() const;
	static int _task_id;
};

template<class T> int ModuleBase<T>::print_status() { return 0; }
template<class T> int ModuleBase<T>::_task_id = -1;

void PRINT_MODULE_DESCRIPTION(const char *description);
void PRINT_MODULE_USAGE_NAME(const char *executable_name, const char *category);
void PRINT_MODULE_USAGE_COMMAND_DESCR(const char *name, const char *description);
#define PRINT_MODULE_USAGE_COMMAND(name) PRINT_MODULE_USAGE_COMMAND_DESCR(name, nullptr)
#define PRINT_MODULE_USAGE_DEFAULT_COMMANDS() PRINT_MODULE_USAGE_COMMAND("stop")
